"""`tactiled serve`: the sensors of other processes, over HTTP and WebSocket."""

from threadpoolctl import threadpool_limits

from tactiled.cli import options
from tactiled.cli.app import stoppable
from tactiled.config import load_served
from tactiled.errors import ConfigError
from tactiled.interop import zenoh_session
from tactiled.interop.zenoh_fleet import Fleet
from tactiled.threads import limit_heaps
from tactiled.web import server


def serve(config: options.Config, _: options.LogFormat = "console") -> None:
    """Serve the sensors that `run --publish` publishes on a Zenoh network; reads no bus."""
    limit_heaps()
    settings = load_served(config)
    for key in ("foxglove", "xela", "recordings"):
        if getattr(settings.server, key) is not None:
            raise ConfigError(f"{config}: server.{key}: belongs to the reader, `tactiled run`: leave it out here")
    zenoh_session.need(f"{config}: zenoh")
    with threadpool_limits(1):
        fleet = Fleet(settings.zenoh, settings.server)
        with stoppable(), fleet.running():
            server.serve(fleet, settings.server)
