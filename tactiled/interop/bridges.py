"""Every bridge there is: ours, and the entry points `tactiled.bridges` of other packages."""

from importlib.metadata import entry_points

from tactiled.config import Server
from tactiled.errors import ConfigError
from tactiled.interop.xela import XelaClients
from tactiled.web.bridge import Bridge

GROUP = "tactiled.bridges"


def configured(server: Server, rerun: int | None = None) -> list[Bridge]:
    """The bridges of a service that are asked for; ConfigError where there is none of a name, or it fails.

    `rerun` is the port of its viewer.
    """
    bridges: list[Bridge] = [XelaClients()]
    if server.foxglove is not None:
        from tactiled.interop.foxglove import Foxglove  # an extra

        bridges.append(Foxglove(server.foxglove))
    if rerun is not None:
        from tactiled.interop.rerun import Rerun

        bridges.append(Rerun(rerun))
    return bridges + [_load(name) for name in server.bridges]


def _load(name: str) -> Bridge:
    """Make a bridge of another package, which is a subclass of Bridge that takes nothing."""
    offers = entry_points(group=GROUP)
    if len(chosen := offers.select(name=name)) != 1:
        known = ", ".join(sorted(offers.names)) or "none"
        raise ConfigError(f"server.bridges: {name!r}: offered by {len(chosen)} packages; there are {known}")
    try:
        bridge = chosen[name].load()()
    except Exception as error:  # what another package may raise
        raise ConfigError(f"server.bridges: {name!r}: fails: {type(error).__name__}: {error}") from error
    if not isinstance(bridge, Bridge):
        raise ConfigError(f"server.bridges: {name!r}: is no tactiled.web.bridge.Bridge")
    return bridge
