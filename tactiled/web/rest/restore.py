"""`POST /api/v1/restore`: frames as .npy in, restored images as .npy out; one request is restored at a time."""

import asyncio
import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from math import prod
from pathlib import Path
from tempfile import gettempdir
from threading import Event
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field
from starlette.types import Message, Receive, Scope, Send

from tactiled.build import SensorPlan
from tactiled.errors import ConfigError
from tactiled.files import clear_scratch, scratch_folder
from tactiled.processes import Cancelled
from tactiled.recorded.offline import Offline, open_frames
from tactiled.web.http.limits import busy, client_of
from tactiled.web.http.problems import Problem
from tactiled.web.rest.dependencies import CurrentService, in_unit, without_path
from tactiled.web.rest.openapi import CONTROL, MEDIA, problems, success
from tactiled.web.rest.uploads import while_connected
from tactiled.web.schemas import MethodName

MAX_IMAGE_BYTES = 256 << 20  # of the answer
MAX_TRANSFERS = 4  # requests whose frames or images come in or go out, and lie on the disk meanwhile
RESPONSES = success("restored images, float32", "npy") | problems(404, 408, 409, 413, *CONTROL)
BODY = {"required": True, "content": {MEDIA["npy"]: {"schema": {"type": "string", "format": "binary"}}}}
NOISE: dict[str, Any] = {"ge": 1e-6, "le": 1e6, "allow_inf_nan": False}

router = APIRouter(prefix="/api/v1")


class Transfers:
    """Requests on their way in or out, one of a client and MAX_TRANSFERS of all; one is restored at a time."""

    def __init__(self) -> None:
        self.clients: set[str] = set()  # from the body's first byte to the answer's last
        self.restoring = asyncio.Lock()
        clear_scratch(Path(gettempdir()))  # of frames whose service kill -9 ended

    @contextmanager
    def one(self, scope: Scope) -> Iterator[None]:
        """One request from its body to the end of its answer; Problem 429 where it is one too many."""
        address = client_of(scope)
        self.need_none_restored()
        if address in self.clients:
            raise busy(f"frames of {address or 'this client'} are in transfer")
        if len(self.clients) >= MAX_TRANSFERS:
            raise busy(f"frames of {MAX_TRANSFERS} clients are in transfer")
        self.clients.add(address)
        try:
            yield
        finally:
            self.clients.remove(address)

    def need_none_restored(self) -> None:
        """Problem 429 while other frames are being restored."""
        if self.restoring.locked():
            raise busy("other frames are being restored")


class _TransferredFile(FileResponse):
    """A file, and what ends with its last byte: its client may send the next request at once."""

    def __init__(self, path: Path, transfer: ExitStack, **options: Any) -> None:
        super().__init__(path, **options)
        self._transfer = transfer

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it, or a part of it if the client leaves."""

        async def sending(message: Message) -> None:
            await send(message)
            if message["type"] == "http.response.body" and not message.get("more_body"):
                self._transfer.close()

        with self._transfer:
            await super().__call__(scope, receive, sending)


class RestoreQuery(BaseModel):
    """How to restore frames."""

    sensor: str = Field(description="a sensor, as in the configuration", examples=["palm"])
    method: MethodName = Field("auto", description="restoration method")
    noise: float | None = Field(
        None, **NOISE, description="a taxel's standard deviation, in the sensor's `unit`; measured if left out"
    )
    noise_kpa: float | None = Field(
        None, **NOISE, description="the same of a calibrated sensor, kPa, unless `noise` is given"
    )


@router.post(
    "/restore", tags=["frames"], response_class=Response, responses=RESPONSES, openapi_extra={"requestBody": BODY}
)
async def restore(
    request: Request, service: CurrentService, query: Annotated[RestoreQuery, Query()]
) -> FileResponse:
    """Restore frames: `.npy` of (T, rows, columns) or (T, taxels), NaN: unknown, with the sensor's kernel.

    Frames and images are in the sensor's `unit`. The headers of the answer give the noise
    and the number of frames for each method.
    """
    transfers: Transfers = request.app.state.transfers
    plan = service.sensor(query.sensor).plan
    with ExitStack() as stack:
        stack.enter_context(transfers.one(request.scope))
        folder = stack.enter_context(scratch_folder(Path(gettempdir())))
        frames, images = folder / "frames.npy", folder / "restored.npy"
        with frames.open("wb") as file:
            async for chunk in request.stream():
                file.write(chunk)
        transfers.need_none_restored()
        async with transfers.restoring:
            cancelled = Event()
            work = partial(_restore, plan, frames, images, query, cancelled)
            headers = await while_connected(request, None, work, cancelled.set)
        frames.unlink()
        transfer = stack.pop_all()
    return _TransferredFile(images, transfer, headers=headers, media_type=MEDIA["npy"])


def _restore(plan: SensorPlan, path: Path, images: Path, query: RestoreQuery, cancelled: Event) -> dict[str, str]:
    """Restore the frames of a file; gives the headers of the answer, or raises Cancelled."""

    def go_on() -> None:
        if cancelled.is_set():
            raise Cancelled

    try:
        frames = open_frames(path, plan)
    except ConfigError as error:
        raise ConfigError(f"body: {without_path(error, path)}") from error
    if 4 * len(frames) * prod(plan.cells.shape) > MAX_IMAGE_BYTES:
        bound = f"{MAX_IMAGE_BYTES >> 20} MiB"
        raise Problem(413, f"{len(frames)} frames make images of more than {bound}: send them in parts")
    noise = in_unit(plan, "noise", query.noise, query.noise_kpa)
    offline = Offline(plan, frames, query.method, noise, go_on)
    methods = offline.write(images)
    return {
        "X-Tactiled-Noise": f"{offline.noise_kpa:.6g}",
        "X-Tactiled-Methods": json.dumps(methods),
        "X-Tactiled-Unit": plan.unit,
    }
