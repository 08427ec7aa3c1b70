"""The service of a configuration file: `run` starts what `check` only makes."""

from pathlib import Path

from tactiled.config import load
from tactiled.runtime.service import Service
from tactiled.runtime.state import State, default


def prepared(config: Path) -> Service:
    """The service of a configuration file, all of it made and nothing started."""
    settings = load(config)
    return Service(settings, state=State(settings.server.state or default(config)))
