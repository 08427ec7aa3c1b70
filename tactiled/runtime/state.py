"""The state file: methods that clients set and keep, read at start."""

import hashlib
import json
import os
import threading
from pathlib import Path
from typing import Any

from tactiled.errors import ConfigError, StateError
from tactiled.files import atomic_write

VERSION = 1


def default_path(config: Path) -> Path:
    """The state file of a configuration that names none, in the user's state directory; or ConfigError."""
    config = config.resolve()
    digest = hashlib.sha256(str(config).encode()).hexdigest()[:8]
    try:
        home = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    except RuntimeError as error:
        raise ConfigError(
            "server.state is missing and there is no home directory: set server.state, HOME or XDG_STATE_HOME"
        ) from error
    return home / "tactiled" / f"{config.stem}-{digest}.json"


class StateFile:
    """Methods kept by sensor; on the disk it is the old file or the new one, never half of one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self.methods = _read(path)

    def keep(self, sensor: str, method: str | None) -> None:
        """Keep a sensor's method (None: the configured one); StateError, and nothing kept, where that fails."""
        with self._lock:
            methods = {name: each for name, each in self.methods.items() if name != sensor}
            if method is not None:
                methods[sensor] = method
            if methods != self.methods:
                _write(self.path, {"version": VERSION, "methods": methods})
            self.methods = methods


def _read(path: Path) -> dict[str, str]:
    try:
        content: Any = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"state {path}: {error}: mend it or delete it") from error
    methods = content.get("methods") if isinstance(content, dict) and content.get("version") == VERSION else None
    if not isinstance(methods, dict) or not all(isinstance(each, str) for each in methods.values()):
        raise ConfigError(f"state {path}: no state file of version {VERSION}: delete it")
    return methods


def _write(path: Path, content: object) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path, replace=True) as part:
            part.write_text(json.dumps(content, indent=1), "utf-8")
    except OSError as error:
        raise StateError(f"state {path}: {error.strerror}: nothing was kept") from error
