"""The service of a configuration file: `run` starts what `check` only makes."""

from pathlib import Path

from tactiled.config import load
from tactiled.runtime.service import Service
from tactiled.runtime.state import StateFile, default_path


def prepared(config: Path) -> Service:
    """The service of a configuration file, all of it made and nothing started."""
    settings = load(config)
    return Service(settings, state=StateFile(settings.server.state or default_path(config)))
