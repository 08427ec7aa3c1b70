"""The ASGI application: REST, streams and the viewer's files."""

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from fastapi import Depends, FastAPI, Request
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.concurrency import run_in_threadpool
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tactiled import __version__
from tactiled.config import Server
from tactiled.guided.calibrations import GuidedCalibrations
from tactiled.processes import SideProcess
from tactiled.web.bridge import Bridge
from tactiled.web.http.auth import AccessControl, Tokens
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit, Turns
from tactiled.web.http.problems import install
from tactiled.web.rest import (
    calibration,
    calibration_file,
    config,
    events,
    frames,
    metrics,
    openapi,
    regions,
    restore,
    sensors,
    trace,
)
from tactiled.web.rest.dependencies import Costly, check_body, check_parameters
from tactiled.web.rest.openapi import EVERY_RESOURCE, problems
from tactiled.web.views import ServiceView
from tactiled.web.ws import asyncapi, push, stream
from tactiled.web.ws.feed import Feeds, ticking

if TYPE_CHECKING:
    from tactiled.live.service import Service

STATIC = Path(__file__).parent / "static"
API_PAGE_FILES = ("fastapi_offline", "static")  # package and folder
MIN_GZIP_BYTES = 2048
INCOMPRESSIBLE = ("application/x-npy", "application/x-npz", "application/octet-stream")  # pressures
RESOURCES = sensors, regions, calibration, calibration_file, frames, trace  # of one sensor
DESCRIPTION = """Raw and restored pressure images of covered tactile arrays.

Live images: `WS /api/v1/sensors/{name}/stream` and `WS /api/v1/stream`, described in AsyncAPI by
[asyncapi.json](asyncapi.json)."""


def create(service: "Service", server: Server, bridges: Sequence[Bridge] = ()) -> FastAPI:
    """Make the application of a service, with what its bridges serve there."""
    app, feeds = begin(service, server)
    app.state.bridges = bridges
    app.state.calibrations = GuidedCalibrations(service)
    app.state.closing.append(app.state.calibrations.close)
    app.state.transfers = restore.Transfers()
    for resource in (config, restore):
        app.include_router(resource.router, responses=problems(*EVERY_RESOURCE))
    if server.recordings is not None:
        from tactiled.web.rest import playback, recordings  # which import python-can

        buses = {} if service.replayed else service.buses
        folder = recordings.Recordings(server.recordings, buses, service.events, server.recordings_leave_mb)
        playbacks = playback.Playbacks(server.recordings_leave_mb)
        app.state.closing += [folder.close, playbacks.close]
        app.include_router(playback.make(folder, playbacks))
        app.include_router(recordings.make(folder))
    for router in [each.routes(feeds) for each in bridges]:
        if router is not None:
            app.include_router(router)
    app.include_router(push.make(service, server))
    return complete(app, server)


def begin(service: ServiceView, server: Server) -> tuple[FastAPI, Feeds]:
    """An application with the resources of sensors, and the feeds of its streams."""
    feeds = Feeds(service)
    app = FastAPI(
        title="tactiled",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lambda app: _lifespan(app, feeds),
        openapi_url="/api/v1/openapi.json",
        docs_url=None,  # FastAPI's own page needs the internet and a script inside it
        redoc_url=None,
        redirect_slashes=False,  # which would redirect to the client's own Host, and hand its token on
        dependencies=[Depends(check_parameters), Depends(check_body)],
    )
    install(app)
    _set_state(app, service, server)
    app.include_router(metrics.router)
    app.include_router(stream.make(feeds, service.faults))
    app.include_router(asyncapi.router)
    for resource in (*RESOURCES, events):
        app.include_router(resource.router, responses=problems(*EVERY_RESOURCE))
    return app, feeds


@asynccontextmanager
async def _lifespan(app: FastAPI, feeds: Feeds) -> AsyncIterator[None]:
    """Wake the clients of streams meanwhile; close at the end what resources have open."""
    async with ticking(feeds):
        yield
    for close in app.state.closing:
        await run_in_threadpool(close)


def complete(app: FastAPI, server: Server) -> FastAPI:
    """Add what comes behind all resources: pages, and what sees a request before them."""
    app.include_router(stream.no_stream())  # behind all other streams
    _add_pages(app)
    uncompressed = (*INCOMPRESSIBLE, *DEFAULT_EXCLUDED_CONTENT_TYPES)
    app.add_middleware(
        GZipMiddleware, minimum_size=MIN_GZIP_BYTES, compresslevel=4, exclude_content_types=uncompressed
    )
    app.add_middleware(Head)
    limits = {"rates": RateLimit(server.control_per_minute), "streams": app.state.streams}
    app.add_middleware(AccessControl, server=server, **limits)  # the first to see a request
    app.openapi = openapi.complete(app, Tokens(server).required)  # type: ignore[method-assign]
    return app


def _set_state(app: FastAPI, service: ServiceView, server: Server) -> None:
    """What routes find in `request.app.state`."""
    app.state.service, app.state.server = service, server
    app.state.bridges, app.state.closing = (), []  # the latter are called at the end
    app.state.streams = ConcurrencyLimit(server.streams_per_client, server.streams)
    app.state.waiting = ConcurrencyLimit(events.MAX_WAITING_PER_CLIENT, events.MAX_WAITING, "events_waiting")
    app.state.drawing = SideProcess()  # matplotlib would hold up every frame
    costly_rates = RateLimit(server.control_per_minute)  # apart from changes: a client that looks may still change
    app.state.turns = {kind: Turns(costly_rates) for kind in get_args(Costly)}


def _add_pages(app: FastAPI) -> None:
    """The viewer, the page of the REST API, and their files."""

    def page(name: str) -> Callable[[Request], FileResponse]:
        return lambda _: FileResponse(STATIC / name, headers={"Cache-Control": "no-cache"})

    app.add_route("/", page("index.html"), include_in_schema=False)
    app.add_route("/docs", page("docs.html"), include_in_schema=False)
    app.mount("/static/swagger", StaticFiles(packages=[API_PAGE_FILES]), name="swagger")
    app.mount("/static", StaticFiles(directory=STATIC), name="static")


class Head:
    """Answers HEAD as GET, without the body (RFC 9110, 9.1); FastAPI answers 405 (fastapi/fastapi#1773)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        ended = False

        async def send_without_body(message: Message) -> None:
            nonlocal ended
            if message["type"] != "http.response.body":
                await send(message)
            elif not ended:  # the server then reports a disconnection, at which no more of a file is read
                ended = True
                await send({"type": "http.response.body"})

        headers = [each for each in scope["headers"] if each[0] != b"range"]  # RFC 9110, 14.2: GET only
        await self._app({**scope, "method": "GET", "headers": headers}, receive, send_without_body)
