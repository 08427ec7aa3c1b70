"""`GET /api/v1/events`: what happened, as it happens."""

import asyncio
from contextlib import suppress
from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import Field

from tactiled.runtime.events import Events, Kind
from tactiled.web import schemas
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.rest.common import WAIT, Responses, Served, problem

router = APIRouter(prefix="/api/v1", tags=["service"])


class EventForm(schemas.Form):
    """One thing that happened."""

    id: int = Field(description="1, 2, 3, ... since the service was started", examples=[17])
    time: float = Field(description="s, Unix", examples=[1763712000.25])
    kind: Kind = Field(examples=["sensor_stale"])
    sensor: str | None = Field(examples=["palm"])
    bus: str | None = Field(examples=[None])
    text: str = Field(description="one line for people", examples=["no frame for 0.6 s"])
    warning: schemas.WarningForm | None = Field(
        None, description="that was raised or cleared; null in other events", examples=[None]
    )


class EventsForm(schemas.Form):
    """What happened after an event, in order."""

    events: tuple[EventForm, ...]
    newest: int = Field(
        description="id of the newest there is; 0: none yet, and the service was started anew where it falls",
        examples=[17],
    )
    missed: int = Field(description="events after `after` that are no longer kept", examples=[0])


WAITING, WAITING_PER_CLIENT = 64, 16  # requests that wait for the next event
TOO_MANY_WAIT: Responses = {
    429: problem(
        "as many requests of this client wait already",
        f"events_waiting_per_client = {WAITING_PER_CLIENT}: 127.0.0.1 has as many open: close one",
        Retry_After=WAIT,
    ),
    503: problem(
        "as many requests of all clients wait already",
        f"events_waiting = {WAITING}: as many are open: come again later",
        Retry_After=WAIT,
    ),
}

After = Annotated[int, Query(ge=0, le=2**53, description="id of the last event that the client has")]
Limit = Annotated[int, Query(ge=1, le=1000, description="events in one answer")]
Wait = Annotated[
    float,
    Query(ge=0, le=30, allow_inf_nan=False, description="seconds to wait for the next event if there is none"),
]


@router.get("/events", responses=TOO_MANY_WAIT)
async def events(
    request: Request, service: Served, after: After = 0, limit: Limit = 100, wait: Wait = 0.0
) -> EventsForm:
    """Events after a given one; the service keeps the last 1000.

    An `after` above the newest id, from before a restart of the service, counts as 0.
    """
    kept = service.events
    if after == kept.newest and wait:
        waiting: ConcurrencyLimit = request.app.state.waiting
        with waiting.one(request.scope):
            await _next(kept, after, wait)
    after = after if after <= kept.newest else 0
    found = kept.after(after)
    return EventsForm(
        events=tuple(EventForm(**asdict(each)) for each in found[:limit]),
        newest=kept.newest,
        missed=found[0].id - after - 1 if found else 0,
    )


async def _next(kept: Events, after: int, wait: float) -> None:
    """Wait for an event after `after`, at most `wait` s."""
    loop, come = asyncio.get_running_loop(), asyncio.Event()
    stop = kept.subscribe(lambda _: _wake(loop, come))
    try:
        if kept.newest == after:
            async with asyncio.timeout(wait):
                await come.wait()
    except TimeoutError:
        return
    finally:
        stop()


def _wake(loop: asyncio.AbstractEventLoop, come: asyncio.Event) -> None:
    """Tell a loop from another thread; one that has ended has nobody left who waits."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(come.set)
