"""`GET /api/v1/config`: what the service runs with, without its secrets."""

from typing import Literal

from fastapi import APIRouter, Request
from pydantic import Field

from tactiled.config import Server, parse, schema
from tactiled.config.example import EXAMPLE
from tactiled.runtime.service import Service
from tactiled.web import schemas
from tactiled.web.rest.common import Served

EXEMPLARY = parse(EXAMPLE.replace("# noise", "noise")).sensor["palm"]

router = APIRouter(prefix="/api/v1", tags=["service"])


class ServerForm(schemas.Form):
    """Where clients find the service and what they may do."""

    host: str = Field(examples=["127.0.0.1"])
    port: int = Field(examples=[8000])
    read_token: bool = Field(description="whether one is needed", examples=[False])
    control_token: bool = Field(description="whether one is needed", examples=[False])
    tls: bool = Field(examples=[False])
    foxglove: int | None = Field(description="port on loopback for Foxglove's apps", examples=[8765])
    xela: int | None = Field(description="port for XELA's clients alone", examples=[5000])
    xela_host: str = Field(description="address of that port", examples=["127.0.0.1"])
    recordings: bool = Field(description="whether clients may record", examples=[True])
    recordings_leave_mb: float = Field(description="of their disk; 0: no bound", examples=[1000.0])
    keeps_state: bool = Field(description="whether `keep` is possible", examples=[True])
    history_s: float = Field(examples=[5.0])
    history_mb: float = Field(examples=[64.0])
    control_per_minute: int = Field(examples=[600])
    streams_per_client: int = Field(examples=[64])
    streams: int = Field(examples=[256])


class Override(schemas.Form):
    """What is not as configured."""

    sensor: schemas.Name
    key: Literal["method"] = "method"
    configured: str = Field(examples=["auto"])
    value: str = Field(examples=["nnls"])
    kept: bool = Field(description="whether a restart keeps it", examples=[True])


class ConfigForm(schemas.Form):
    """The configuration as read, with every default, and what clients changed since."""

    server: ServerForm
    bus: dict[str, schema.Bus] = Field(
        description="python-can's settings; secrets are hidden",
        examples=[{"can0": {"interface": "socketcan", "channel": "can0"}}],
    )
    sensor: dict[str, schema.Sensor] = Field(
        description="as in the file, units in the keys",
        examples=[
            {
                name: each.model_dump(mode="json")
                for name, each in parse(EXAMPLE.replace("# noise", "noise")).sensor.items()
            }
        ],
    )
    overrides: tuple[Override, ...]


@router.get("/config")
def config(request: Request, service: Served) -> ConfigForm:
    """The configuration with every default, without secrets, and the changes that clients made."""
    return ConfigForm(
        server=_server(request.app.state.server, service),
        bus=dict(service.config.bus),
        sensor=dict(service.config.sensor),
        overrides=tuple(_overrides(service)),
    )


def _server(server: Server, service: Service) -> ServerForm:
    return ServerForm(
        host=server.host,
        port=server.port,
        read_token=server.read_token is not None or server.control_token is not None,
        control_token=server.control_token is not None,
        tls=server.tls_certificate is not None,
        foxglove=server.foxglove,
        xela=server.xela,
        xela_host=server.xela_host,
        recordings=server.recordings is not None,
        recordings_leave_mb=server.recordings_leave_mb,
        keeps_state=service.state is not None,
        history_s=server.history_s,
        history_mb=server.history_mb,
        control_per_minute=server.control_per_minute,
        streams_per_client=server.streams_per_client,
        streams=server.streams,
    )


def _overrides(service: Service) -> list[Override]:
    kept = service.state.methods if service.state else {}
    return [
        Override(
            sensor=name,
            configured=sensor.plan.method,
            value=sensor.method,
            kept=kept.get(name) == sensor.method,
        )
        for name, sensor in service.sensors.items()
        if sensor.method != sensor.plan.method
    ]
