"""`GET /api/v1/sensors/{name}/trace`: the way of the next frame through all stages."""

import asyncio
import time
from contextlib import ExitStack, suppress

from fastapi import APIRouter, Request
from pydantic import Field

from tactiled.frames import SensorImage
from tactiled.web import schemas
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.rest.dependencies import NamedSensor, no_frame
from tactiled.web.rest.openapi import problems

MAX_WAIT_S = 5.0  # for the next frame of a live sensor
MAX_SEND_S = 0.5  # how long an image's sends are waited for, unless a newer image comes first
router = APIRouter(prefix="/api/v1", tags=["frames"])


class Trace(schemas.Schema):
    """The way of one frame."""

    sensor: schemas.SensorName
    sequence: int = Field(examples=[5123])
    timestamp: float = Field(description="s, Unix, of the first message", examples=[1763712000.25])
    method: str = Field(description="that ran", examples=["tv"])
    why: str = Field(description="why it was chosen", examples=["selected by hand"])
    iterations: int = Field(examples=[6])
    warnings: tuple[schemas.FrameWarning, ...]
    contacts: int | None = Field(
        description="null: a newer frame came before they were searched for", examples=[2]
    )
    sends: int = Field(description="to clients of WebSockets", examples=[1])
    age_s: dict[str, float] = Field(
        description="since the frame's last message, when it had passed each stage: first_message, last_message, "
        "assembled (in counts), started (its turn came), calibrated, restored, checked (warnings), published, "
        "contacts, sent_first, sent_last (to clients)",
        examples=[{"last_message": 0.0, "restored": 0.00048}],
    )


@router.get("/sensors/{name}/trace", responses=problems(404, 429, 503))
async def trace(sensor: NamedSensor, request: Request) -> Trace:
    """Get the next frame's times from its first CAN message to the clients that it was sent to.

    The answer comes when the frame after it is published, or after 0.5 s.
    """
    loop = asyncio.get_running_loop()
    traced, overtaken = (loop.create_future() for _ in range(2))
    sends: list[tuple[SensorImage, float]] = []

    def take(image: SensorImage, published: float) -> None:
        future = overtaken if traced.done() else traced
        if not future.done():
            future.set_result((image, published))

    def publish(image: SensorImage) -> None:  # on the sensor's thread
        with suppress(RuntimeError):  # a closed loop has no waiting request
            loop.call_soon_threadsafe(take, image, time.monotonic())

    waiting: ConcurrencyLimit = request.app.state.waiting
    with waiting.one(request.scope), ExitStack() as stack:
        stack.callback(sensor.sends.subscribe(sends.append))
        stack.callback(sensor.hub.subscribe(publish))
        try:
            image, published = await asyncio.wait_for(traced, MAX_WAIT_S if sensor.state == "live" else 0.0)
        except TimeoutError as error:
            raise no_frame(sensor) from error
        searched, contacts = await asyncio.to_thread(sensor.contacts)
        times = {"published": published} | ({"contacts": time.monotonic()} if searched is image else {})
        with suppress(TimeoutError):
            await asyncio.wait_for(overtaken, MAX_SEND_S)
    sent_at = [at for each, at in sends if each is image]
    times |= {"sent_first": min(sent_at), "sent_last": max(sent_at)} if sent_at else {}
    made = image.times._asdict() if image.times else {}  # none of an image that was made elsewhere
    origin = made.get("last_message", published)
    return Trace(
        **Trace.shared(image) | {"contacts": len(contacts) if searched is image else None},
        timestamp=image.time,
        sends=len(sent_at),
        age_s={stage: at - origin for stage, at in (made | times).items()},
    )
