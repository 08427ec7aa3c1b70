"""`POST /api/v1/restore`: a film of frames as .npy in, restored as .npy out, one at a time, a few in transit."""

import asyncio
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from math import ceil, prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, NamedTuple

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse
from numpy.typing import NDArray
from starlette.types import Message, Receive, Scope, Send

from tactiled.build import SensorPlan
from tactiled.errors import ConfigError
from tactiled.runtime.offline import Offline, open_frames, write
from tactiled.runtime.service import Service
from tactiled.web.http.body import MAX_UPLOAD_BYTES
from tactiled.web.http.limits import client_of
from tactiled.web.http.problems import Problem
from tactiled.web.rest.common import CONTROL, LATE, NO_SENSOR, WAIT, Responses, problem
from tactiled.web.schemas import MethodName

MOST_OUT = 256 << 20  # bytes of its images
MOST_HELD = 4  # films that come in or go out, and lie on the disk meanwhile
NPY = "application/x-npy"
RESPONSES: Responses = (
    LATE
    | CONTROL
    | NO_SENSOR
    | {
        200: {"description": "restored images, float32 kPa", "content": {NPY: {"schema": {"type": "string"}}}},
        413: problem(
            f"more than {MAX_UPLOAD_BYTES >> 20} MiB, or images of more than {MOST_OUT >> 20} MiB",
            f"a body of more than {MAX_UPLOAD_BYTES >> 10} KiB: send it in parts",
        ),
        422: problem(
            "no .npy of frames of this sensor's shape, or a wrong parameter",
            "body: no .npy file of numbers: give frames in kPa as .npy",
        ),
        429: problem(
            "another film is being restored, one of this client or too many of others come in or go out, or more "
            "than control_per_minute",
            "another film is being restored: wait",
            Retry_After=WAIT,
        ),
    }
)
BODY = {"requestBody": {"required": True, "content": {NPY: {"schema": {"type": "string", "format": "binary"}}}}}

router = APIRouter(prefix="/api/v1")
Name = Annotated[str, Query(description="a sensor, as in the configuration", examples=["palm"])]
SIGMA = "a taxel's standard deviation; measured if left out"
Method = Annotated[MethodName, Query(description="restoration method")]
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
    """The films that clients have restored, one at a time; one of a client, a few of all come in or go out."""

    def __init__(self) -> None:
        self.now: Progress | None = None  # the one that is being restored
        self._held: dict[str, Progress] = {}  # by client, from the body's first byte to the answer's last

    @contextmanager
    def held(self, scope: Scope) -> Iterator[Progress]:
        """One film from its body to the end of its answer; Problem 429 where it is one too many."""
        who = client_of(scope)
        self._refuse("another film is being restored", self.now)
        self._refuse(f"another film of {who or 'this client'} comes in or goes out", self._held.get(who))
        if len(self._held) >= MOST_HELD:
            self._refuse(f"{MOST_HELD} films come in or go out", min(self._held.values(), key=Progress.wait))
        self._held[who] = Progress()
        try:
            yield self._held[who]
        finally:
            del self._held[who]

    @contextmanager
    def one(self, film: Progress) -> Iterator[None]:
        """Restore this one, which has come in; Problem 429 while it is another's turn."""
        self._refuse("another film is being restored", self.now)
        self.now = film
        try:
            yield
        finally:
            self.now = None

    def _refuse(self, why: str, other: Progress | None) -> None:
        if other is not None:
            raise Problem(429, f"{why}: wait", {"Retry-After": str(other.wait())})


class _Sent(FileResponse):
    """A file, and what is held until it is sent, or its client cut off."""

    def __init__(self, path: Path, held: ExitStack, **options: Any) -> None:
        super().__init__(path, **options)
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it; who has all of it may have the next film restored at once."""

        async def sending(message: Message) -> None:
            await send(message)
            if message["type"] == "http.response.body" and not message.get("more_body"):
                self._held.close()

        with self._held:
            await super().__call__(scope, receive, sending)


class _Done(NamedTuple):
    noise_kpa: float
    methods: dict[str, int]


@router.post("/restore", tags=["frames"], response_class=Response, responses=RESPONSES, openapi_extra=BODY)
async def restore(
    request: Request, sensor: Name, method: Method = "auto", noise_kpa: Noise = None
) -> FileResponse:
    """Restore frames, `.npy` of (T, rows, columns) or (T, taxels) in kPa, NaN: unknown, with the sensor's kernel.

    The headers of the answer give the noise (kPa) and the number of frames for each method.
    """
    service: Service = request.app.state.service
    films: Films = request.app.state.films
    plan = service.sensor(sensor).plan
    with ExitStack() as stack:
        progress = stack.enter_context(films.held(request.scope))
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="tactiled-")))
        film, images = folder / "frames.npy", folder / "restored.npy"
        await _receive(request, film)
        with films.one(progress):
            done = await asyncio.to_thread(_restore, plan, film, images, method, noise_kpa, progress)
        film.unlink()
        held = stack.pop_all()
    headers = {"X-Tactiled-Noise": f"{done.noise_kpa:.6g}", "X-Tactiled-Methods": json.dumps(done.methods)}
    return _Sent(images, held, headers=headers | {"X-Tactiled-Unit": "kPa"}, media_type=NPY)


async def _receive(request: Request, path: Path) -> None:
    """Take the body in."""
    with path.open("wb") as file:
        async for piece in request.stream():
            file.write(piece)


def _restore(
    plan: SensorPlan, film: Path, images: Path, method: str, noise_kpa: float | None, progress: Progress
) -> _Done:
    try:
        frames = open_frames(film, plan)
    except ConfigError as error:
        raise ConfigError(str(error).replace(str(film), "body")) from error
    shape = (len(frames), *plan.blur.surface_shape)
    if 4 * prod(shape) > MOST_OUT:
        raise Problem(
            413, f"{len(frames)} frames make images of more than {MOST_OUT >> 20} MiB: send them in parts"
        )
    progress.begin(len(frames))
    offline, chosen = Offline(plan, frames, method, noise_kpa), Counter[str]()

    def pieces() -> Iterator[NDArray[np.float32]]:
        for restored, infos in offline:
            chosen.update(each.method for each in infos)
            yield restored

    write(pieces(), shape, images, progress.add)
    return _Done(offline.noise_kpa, dict(chosen))
