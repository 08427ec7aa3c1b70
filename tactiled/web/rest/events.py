"""`GET /api/v1/events`: what happened, as it happens."""

import asyncio
from contextlib import suppress
from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, Field

from tactiled.live.events import Events as EventLog
from tactiled.live.events import Kind
from tactiled.web import schemas
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.rest.dependencies import CurrentService
from tactiled.web.rest.openapi import problems

MAX_WAITING, MAX_WAITING_PER_CLIENT = 64, 16  # requests that wait for the next event
router = APIRouter(prefix="/api/v1", tags=["service"])


class Event(schemas.Schema):
    """One thing that happened."""

    id: int = Field(description="1, 2, 3, ... since the service was started", examples=[17])
    time: float = Field(description="s, Unix", examples=[1763712000.25])
    kind: Kind = Field(examples=["sensor_stale"])
    sensor: str | None = Field(examples=["palm"])
    bus: str | None = Field(examples=[None])
    text: str = Field(description="one line for people", examples=["no frame for 0.6 s"])
    warning: schemas.FrameWarning | None = Field(description="that was raised or cleared", examples=[None])


class Events(schemas.Schema):
    """What happened after an event, in order."""

    events: tuple[Event, ...]
    newest: int = Field(
        description="id of the newest event, 0: none yet; if it falls, the service was restarted", examples=[17]
    )
    missed: int = Field(description="events after `after` that are no longer kept", examples=[0])


class EventsQuery(BaseModel):
    """Which events, and how long to wait for one."""

    after: int = Field(0, ge=0, le=2**53, description="id of the last event that the client has")
    limit: int = Field(100, ge=1, le=1000, description="events in one answer")
    wait: float = Field(
        0.0, ge=0, le=30, allow_inf_nan=False, description="seconds to wait for the next event if there is none"
    )


@router.get("/events", responses=problems(429, 503))
async def events(request: Request, service: CurrentService, query: Annotated[EventsQuery, Query()]) -> Events:
    """Get events after a given one; the service keeps the last 1000.

    An `after` above the newest id, from before a restart of the service, counts as 0.
    """
    log = service.events
    if query.after == log.newest and query.wait:
        waiting: ConcurrencyLimit = request.app.state.waiting
        with waiting.one(request.scope):
            await _next(log, query.after, query.wait)
    after = query.after if query.after <= log.newest else 0
    events = log.after(after)
    missed = events[0].id - after - 1 if events else 0
    return Events(events=events[: query.limit], newest=log.newest, missed=missed)


async def _next(log: EventLog, after: int, wait_s: float) -> None:
    """Wait for an event after `after`, at most `wait_s`."""
    loop, happened = asyncio.get_running_loop(), asyncio.Event()

    def wake(_: object) -> None:  # on any thread
        with suppress(RuntimeError):  # a closed loop has no waiting request
            loop.call_soon_threadsafe(happened.set)

    unsubscribe = log.subscribe(wake)
    try:
        if log.newest == after:
            with suppress(TimeoutError):
                await asyncio.wait_for(happened.wait(), wait_s)
    finally:
        unsubscribe()
