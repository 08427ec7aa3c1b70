"""`POST /api/v1/restore`: a film of frames as .npy in, restored as .npy out, one film at a time."""

import asyncio
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import ceil, prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, NamedTuple

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse
from numpy.typing import NDArray
from starlette.background import BackgroundTask

from tactiled.config.build import SensorPlan
from tactiled.errors import ConfigError
from tactiled.offline import Offline, opened, write
from tactiled.service import Service
from tactiled.web.body import MOST_FILM as MOST_IN
from tactiled.web.common import BODY as BODIES
from tactiled.web.common import CONTROL, WAIT, Responses, problem
from tactiled.web.forms import MethodName
from tactiled.web.problems import Problem

MOST_OUT = 256 << 20  # bytes of its images
NPY = "application/x-npy"
RESPONSES: Responses = (
    BODIES
    | CONTROL
    | {
        200: {"description": "restored images, float32 kPa", "content": {NPY: {"schema": {"type": "string"}}}},
        404: problem("no such sensor"),
        413: problem(f"more than {MOST_IN >> 20} MiB, or images of more than {MOST_OUT >> 20} MiB"),
        422: problem("no .npy of frames of this sensor's shape, or a wrong parameter"),
        429: problem("another film is being restored, or more than control_per_minute", Retry_After=WAIT),
    }
)
BODY = {"requestBody": {"required": True, "content": {NPY: {"schema": {"type": "string", "format": "binary"}}}}}

router = APIRouter(prefix="/api/v1")
SIGMA = "a taxel's standard deviation; measured if left out"
Noise = Annotated[float | None, Query(ge=1e-6, le=1e6, allow_inf_nan=False, description=SIGMA)]


class Progress:
    """A film that is being restored: how much of it is done, and since when."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._began = clock, clock()
        self._done = self._frames = 0

    def begin(self, frames: int) -> None:
        """It has come in, and is restored from now on."""
        self._began, self._frames = self._clock(), frames

    def add(self, frames: int) -> None:
        """So many more are done."""
        self._done += frames

    def wait(self) -> int:
        """Seconds (1 or more) until it is done: at its pace, before its first frames as long again as so far."""
        elapsed = self._clock() - self._began
        return max(1, ceil(elapsed * (self._frames - self._done) / self._done if self._done else elapsed))


class Films:
    """The films that clients have restored: one at a time."""

    def __init__(self) -> None:
        self.now: Progress | None = None

    @contextmanager
    def one(self) -> Iterator[Progress]:
        """One film; Problem 429 while there is another."""
        if self.now is not None:
            raise Problem(429, "another film is being restored: wait", {"Retry-After": str(self.now.wait())})
        self.now = Progress()
        try:
            yield self.now
        finally:
            self.now = None


class _Done(NamedTuple):
    noise_kpa: float
    methods: dict[str, int]


@router.post("/restore", tags=["frames"], response_class=Response, responses=RESPONSES, openapi_extra=BODY)
async def restore(
    request: Request, sensor: str, method: MethodName = "auto", noise_kpa: Noise = None
) -> FileResponse:
    """Restore frames (T, rows, columns) or (T, taxels) in kPa, NaN where unknown, as the sensor's own would be.

    The answer's headers say the noise (kPa) and how often each method ran.
    """
    service: Service = request.app.state.service
    films: Films = request.app.state.films
    plan = service.sensor(sensor).plan
    with films.one() as progress:
        folder = TemporaryDirectory(prefix="tactiled-")
        try:
            film, images = Path(folder.name) / "frames.npy", Path(folder.name) / "restored.npy"
            await _receive(request, film)
            done = await asyncio.to_thread(_restore, plan, film, images, method, noise_kpa, progress)
        except BaseException:
            folder.cleanup()
            raise
    headers = {"X-Tactiled-Noise": f"{done.noise_kpa:.6g}", "X-Tactiled-Methods": json.dumps(done.methods)}
    return FileResponse(
        images,
        headers=headers | {"X-Tactiled-Unit": "kPa"},
        media_type=NPY,
        background=BackgroundTask(folder.cleanup),
    )


async def _receive(request: Request, path: Path) -> None:
    """Take the body in."""
    with path.open("wb") as file:
        async for piece in request.stream():
            file.write(piece)


def _restore(
    plan: SensorPlan, film: Path, images: Path, method: str, noise_kpa: float | None, progress: Progress
) -> _Done:
    try:
        frames = opened(film, plan)
    except ConfigError as error:
        raise ConfigError(str(error).replace(str(film), "body")) from error
    shape = (len(frames), *plan.blur.surface_shape)
    if 4 * prod(shape) > MOST_OUT:
        raise Problem(
            413, f"{len(frames)} frames make images of more than {MOST_OUT >> 20} MiB: send them in parts"
        )
    progress.begin(len(frames))
    offline = Offline(plan, method, noise_kpa)
    noise, chosen = offline.begin(frames), Counter[str]()

    def pieces() -> Iterator[NDArray[np.float32]]:
        for restored, told in offline(frames):
            chosen.update(each.method for each in told)
            yield restored

    write(pieces(), shape, images, progress.add)
    return _Done(noise, dict(chosen))
