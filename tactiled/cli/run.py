"""`tactiled run`: the service on the buses of a configuration."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled.cli.app import stoppable
from tactiled.config import load
from tactiled.service import Service
from tactiled.state import State, default
from tactiled.web.server import serve

Foxglove = Annotated[
    int | None,
    typer.Option(
        metavar="PORT", help="Show it in Foxglove's apps, too, on this port of loopback.", min=0, max=65535
    ),
]


def run(
    config: Annotated[Path, typer.Argument(help="Configuration file (TOML).")],
    foxglove: Foxglove = None,
) -> None:
    """Run the service: read the buses, restore every frame, serve it over HTTP and WebSocket."""
    settings = load(config)
    server = settings.server if foxglove is None else settings.server.model_copy(update={"foxglove": foxglove})
    with threadpool_limits(1):  # frames are small: a second thread costs more than it gives
        service = Service(settings, state=State(settings.server.state or default(config)))
        with stoppable(), service.running():
            serve(service, server)
