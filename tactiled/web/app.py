"""The ASGI application: REST, streams and the viewer's files."""

from pathlib import Path

from fastapi import Depends, FastAPI, Request, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware

from tactiled import __version__
from tactiled.config import Server
from tactiled.runtime.service import Service
from tactiled.web.http import problems
from tactiled.web.http.auth import AccessControl, Tokens
from tactiled.web.http.head import Head
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit
from tactiled.web.rest import config, events, frames, metrics, recordings, restore, sensors, shear
from tactiled.web.rest.common import WRONG, declared, turns
from tactiled.web.rest.constant import constant, text
from tactiled.web.rest.openapi import complete
from tactiled.web.ws import asyncapi, stream, xela
from tactiled.web.ws.feed import Feed, ticking

STATIC = Path(__file__).parent / "static"
SWAGGER = ("fastapi_offline", "static")  # package and folder that hold Swagger UI
MIN_GZIP_BYTES = 2048
INCOMPRESSIBLE = ("application/x-npy", "application/x-npz", "application/octet-stream")  # pressures are noise
ABOUT = """Raw and restored pressure images of covered tactile arrays.

Live images: `WS /api/v1/sensors/{name}/stream` and `WS /api/v1/stream`, described in AsyncAPI by
[asyncapi.json](asyncapi.json)."""


def create(service: Service, server: Server) -> FastAPI:
    """Make the application of a service."""
    feeds = {name: Feed(sensor) for name, sensor in service.sensors.items()}

    app = FastAPI(
        title="tactiled",
        version=__version__,
        description=ABOUT,
        lifespan=lambda _: ticking(feeds),
        openapi_url=None,  # it is served below, as all that stays the same
        docs_url=None,  # FastAPI's own page needs the internet and a script inside it
        redoc_url=None,
        redirect_slashes=False,  # which would tell where to by the client's own Host, and hand its token on
        dependencies=[Depends(declared)],
    )
    problems.install(app)
    app.state.service, app.state.server = service, server
    app.state.films = restore.Films()
    app.state.constants = {}
    app.state.streams = ConcurrencyLimit(server.streams_per_client, server.streams)
    app.state.waiting = ConcurrencyLimit(events.WAITING_PER_CLIENT, events.WAITING, "events_waiting")
    app.state.turns = turns(RateLimit(server.control_per_minute))  # apart from changes: who looks may still change
    for router in (shear.router, sensors.router, frames.router, events.router, config.router, restore.router):
        app.include_router(router, responses=WRONG)
    if server.recordings is not None:
        buses, leave_mb = {} if service.replayed else service.buses, server.recordings_leave_mb
        app.include_router(recordings.make(server.recordings, buses, service.events, leave_mb))

    app.include_router(metrics.router)
    app.include_router(stream.make(feeds, service.faults))
    app.include_router(asyncapi.make())
    app.include_router(xela.make(feeds))
    app.include_router(stream.no_stream())  # behind all other streams

    @app.get("/api/v1/openapi.json", include_in_schema=False)
    async def openapi(request: Request) -> Response:
        return await constant(request, lambda: text(app.openapi()))

    @app.get("/", include_in_schema=False)
    def viewer() -> FileResponse:
        return FileResponse(STATIC / "index.html", headers={"Cache-Control": "no-cache"})

    @app.get("/docs", include_in_schema=False)
    def docs() -> FileResponse:
        return FileResponse(STATIC / "docs.html", headers={"Cache-Control": "no-cache"})

    app.mount("/static/swagger", StaticFiles(packages=[SWAGGER]), name="swagger")
    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    uncompressed = (*INCOMPRESSIBLE, *DEFAULT_EXCLUDED_CONTENT_TYPES)
    app.add_middleware(
        GZipMiddleware, minimum_size=MIN_GZIP_BYTES, compresslevel=4, exclude_content_types=uncompressed
    )
    app.add_middleware(Head)
    limits = {"rates": RateLimit(server.control_per_minute), "streams": app.state.streams}
    app.add_middleware(AccessControl, server=server, **limits)  # the last added is the first met
    app.openapi = complete(app, Tokens(server).required)  # type: ignore[method-assign]
    return app
