"""`/api/v1/config`: what the service runs with, without its secrets; and to read the file again."""

import asyncio
from typing import TYPE_CHECKING, Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field

from tactiled.config import Server, schema
from tactiled.errors import BusError, ConfigError, PhysicsError
from tactiled.live.reload import Reload
from tactiled.web import schemas
from tactiled.web.http.problems import Problem
from tactiled.web.rest.dependencies import CurrentService
from tactiled.web.rest.openapi import CONTROL, problems

if TYPE_CHECKING:
    from tactiled.live.service import Service

router = APIRouter(prefix="/api/v1", tags=["service"])


class Override(schemas.Schema):
    """What is not as configured."""

    sensor: schemas.SensorName
    key: Literal["method"] = "method"
    configured: str = Field(examples=["auto"])
    value: str = Field(examples=["nnls"])
    kept: bool = Field(description="whether a restart keeps it", examples=[True])


class Config(schemas.Schema):
    """The configuration as read, with every default, and what clients changed since."""

    server: dict[str, bool | int | float | str | tuple[str, ...] | None] = Field(
        description="of tokens, certificate, folder and state only whether they are there",
        examples=[{"host": "127.0.0.1", "port": 8000, "control_token": False, "recordings": True}],
    )
    bus: dict[str, schema.Bus] = Field(
        description="python-can's settings; secrets are hidden",
        examples=[{"can0": {"interface": "socketcan", "channel": "can0"}}],
    )
    sensor: dict[str, schema.Sensor] = Field(description="as in the file, units in the keys")
    overrides: tuple[Override, ...]


@router.get("/config")
def config(request: Request, service: CurrentService) -> Config:
    """Get the configuration with every default, without secrets, and the changes that clients made."""
    return Config(
        server=server_settings(request.app.state.server, service.state is not None),
        bus=service.config.bus,
        sensor=service.config.sensor,
        overrides=tuple(_overrides(service)),
    )


@router.post("/config/reload", responses=problems(409, 503, *CONTROL))
async def reload(request: Request, service: CurrentService) -> Reload:
    """Read the configuration file again: only what changed restarts, and a wrong file changes nothing.

    The answer comes when everything runs. A change of `[server]` is refused.
    """
    try:
        return await asyncio.wrap_future(service.start_reload())
    except (ConfigError, PhysicsError) as error:  # the client sees the names of files, and not their paths
        text, server = str(error), request.app.state.server
        for path in filter(None, (service.path, server.tls_certificate, server.tls_key)):
            text = text.replace(str(path), path.name)
        raise Problem(422, text) from error
    except BusError as error:
        raise Problem(503, str(error)) from error


def server_settings(server: Server, keeps_state: bool) -> dict[str, Any]:
    """The table of the server, of its secrets only whether they are there."""
    guarded = server.control_token is not None  # which a read_token needs, too
    secret = {"read_token", "control_token", "tls_certificate", "tls_key", "recordings", "state"}
    return server.model_dump(exclude=secret) | {
        "read_token": guarded,
        "control_token": guarded,
        "tls": server.tls_certificate is not None,
        "recordings": server.recordings is not None,
        "keeps_state": keeps_state,
    }


def _overrides(service: "Service") -> list[Override]:
    kept_methods = service.state.methods if service.state else {}
    return [
        Override(
            sensor=name,
            configured=sensor.plan.method,
            value=sensor.method,
            kept=kept_methods.get(name) == sensor.method,
        )
        for name, sensor in service.sensors.items()
        if sensor.method != sensor.plan.method
    ]
