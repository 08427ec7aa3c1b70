"""`tactiled run`: the service on the buses of a configuration."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled.cli.app import app
from tactiled.config import load
from tactiled.service import Service
from tactiled.state import State, default
from tactiled.web.server import serve


@app.command()
def run(config: Annotated[Path, typer.Argument(help="Configuration file (TOML).")]) -> None:
    """Read the buses of CONFIG, restore every frame and serve it over HTTP and WebSocket."""
    settings = load(config)
    with threadpool_limits(1):  # frames are small: a second thread costs more than it gives
        service = Service(settings, state=State(settings.server.state or default(config)))
        service.start()
        try:
            serve(service, settings.server)
        finally:
            service.stop()
