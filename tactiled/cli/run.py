"""`tactiled run`: the service on the buses of a configuration."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled.cli.app import stoppable
from tactiled.cli.prepare import prepared
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
    with threadpool_limits(1):  # frames are small: a second thread costs more than it gives
        service = prepared(config)
        server = service.config.server
        if foxglove is not None:
            server = server.model_copy(update={"foxglove": foxglove})
        with stoppable(), service.running():
            serve(service, server)
