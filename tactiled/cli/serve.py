"""`tactiled serve`: the sensors of other processes, over HTTP and WebSocket."""

import logging
import re
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled import logs
from tactiled.bounds import NAME
from tactiled.cli import options
from tactiled.cli.app import stoppable
from tactiled.config import load_served
from tactiled.errors import ConfigError
from tactiled.interop.zenoh import session as zenoh_session
from tactiled.interop.zenoh.app import create
from tactiled.interop.zenoh.fleet import Fleet
from tactiled.interop.zenoh.signatures import robot_key
from tactiled.threads import limit_heaps
from tactiled.web import server


def serve(
    config: options.Config,
    key: Annotated[
        str | None,
        typer.Option(metavar="ROBOT", help="Print zenoh.control_key for this robot's readers, and serve nothing."),
    ] = None,
    _: options.LogFormat = "console",
) -> None:
    """Serve the sensors that `run --publish` publishes on a Zenoh network; reads no bus."""
    limit_heaps()
    settings = load_served(config)
    fleet_key = settings.zenoh.control_key
    if key is not None:
        if fleet_key is None:
            raise ConfigError(f"{config}: zenoh.control_key: missing: give what `openssl rand -hex 32` prints")
        if not re.fullmatch(NAME, key):
            raise ConfigError(f"--key {key}: no name of a robot: give zenoh.robot of its readers")
        print(f'control_key = "{robot_key(fleet_key.get_secret_value(), key)}"')
        return
    for key in ("foxglove", "xela", "bridges", "recordings"):
        if getattr(settings.server, key) not in (None, ()):
            raise ConfigError(f"{config}: server.{key}: belongs to the reader, `tactiled run`: leave it out here")
    zenoh_session.need(f"{config}: zenoh")
    if fleet_key is None:
        logs.announce("without zenoh.control_key all sensors are read-only", logging.WARNING)
    with threadpool_limits(1):
        fleet = Fleet(settings.zenoh, settings.server)
        with stoppable(), fleet.running():
            server.serve(create(fleet, settings.server), settings.server, "sensors of all robots")
