"""The state file: methods that clients set and keep, and tares, read at start."""

import fcntl
import hashlib
import json
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tactiled.bounds import reason
from tactiled.calibrate.counts.tare import Zero
from tactiled.calibrate.sections import OptionalValues, Table, Values, optional
from tactiled.contacts.regions import Region
from tactiled.errors import ConfigError, StateError
from tactiled.files import atomic_write

VERSION = 1
Value = TypeVar("Value")
REGIONS = TypeAdapter(dict[str, dict[str, Region]])


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


class KeptTare(Table):
    """A tare as it stands in the file."""

    time: float  # s, Unix
    codec: str
    counts: Values  # of each taxel
    shear: tuple[OptionalValues, OptionalValues]  # counts of each taxel along x and y; None: not tared

    @classmethod
    def of(cls, zero: Zero, codec: str) -> "KeptTare":
        """Of a zero with a time."""
        assert zero.time is not None, "a zero of no tare"
        x, y = map(optional, zero.shear)
        return cls(time=zero.time, codec=codec, counts=tuple(zero.counts.tolist()), shear=(x, y))

    @property
    def zero(self) -> Zero:
        """The zero."""
        return Zero(np.array(self.counts, np.float32), np.array(self.shear, np.float32), self.time)

    def fits(self, codec: str, taxels: int) -> bool:
        """Whether it is of an array of this codec and so many taxels."""
        sizes = {len(each) for each in (self.counts, *self.shear)}
        return codec == self.codec and sizes == {taxels}


class StateFile:
    """Methods and tares by sensor; on the disk it is the old file or the new one, never half of one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self.methods, self.tares, self.regions = _read(path)

    @classmethod
    def of(cls, config: Path, path: Path | None) -> "StateFile":
        """The state of a configuration file's service: at the path that it names, or at the default one."""
        return cls(path or default_path(config))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Have the file for this process alone meanwhile; ConfigError where another service runs with it."""
        with ExitStack() as stack:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                lock = stack.enter_context(self.path.with_name(f".{self.path.name}.lock").open("ab"))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                why = "another service runs with it: give each a server.state of its own"
                raise ConfigError(f"state {self.path}: {why}") from error
            except OSError:
                pass  # nothing can be kept then; a client that asks for it is told why
            yield

    def keep(self, sensor: str, method: str | None) -> None:
        """Keep a sensor's method (None: the configured one); StateError, and nothing kept, where that fails."""
        with self._lock:
            if method != self.methods.get(sensor):
                self._write(methods=_with(self.methods, sensor, method))

    def keep_tare(self, sensor: str, tare: KeptTare | None) -> None:
        """Keep a sensor's tare (None: as configured); StateError, and nothing kept, where that fails."""
        with self._lock:
            self._write(tares=_with(self.tares, sensor, tare))

    def keep_regions(self, sensor: str, regions: Mapping[str, Region]) -> None:
        """Keep a sensor's regions; StateError, and nothing kept, where that fails."""
        with self._lock:
            self._write(regions=_with(self.regions, sensor, dict(regions) or None))

    def _write(self, **changed: Any) -> None:
        """Write the file with another table, which is then this one's, too."""
        methods, tares, regions = (changed.get(key, getattr(self, key)) for key in ("methods", "tares", "regions"))
        content = {
            "version": VERSION,
            "methods": methods,
            "tares": {name: each.model_dump() for name, each in tares.items() if each is not None},
            "regions": REGIONS.dump_python(regions),
        }
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(self.path, replace=True) as part:
                part.write_text(json.dumps(content, indent=1), "utf-8")
        except OSError as error:
            raise StateError(f"state {self.path}: {error.strerror}: nothing was kept") from error
        self.methods, self.tares, self.regions = methods, tares, regions


def _with(table: Mapping[str, Value], name: str, value: Value | None) -> dict[str, Value]:
    """The same with another value of a name, or without it."""
    others = {key: each for key, each in table.items() if key != name}
    return others if value is None else {**others, name: value}


Regions = dict[str, dict[str, Region]]  # by sensor and name


def _read(path: Path) -> tuple[dict[str, str], dict[str, KeptTare | None], Regions]:
    """Methods, tares and regions by sensor; None: a tare that cannot be read."""
    try:
        content: Any = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return {}, {}, {}
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"state {path}: {error}: mend it or delete it") from error
    methods = content.get("methods") if isinstance(content, dict) and content.get("version") == VERSION else None
    if not isinstance(methods, dict) or not all(isinstance(each, str) for each in methods.values()):
        raise ConfigError(f"state {path}: no state file of version {VERSION}: delete it")
    tares = content.get("tares")  # absent in files of 0.4.2
    kept = {name: _tare(each) for name, each in tares.items()} if isinstance(tares, dict) else {}
    try:
        return methods, kept, REGIONS.validate_python(content.get("regions", {}))
    except ValidationError as error:
        raise ConfigError(f"state {path}: regions: {reason(error.errors()[0])}: mend it or delete it") from error


def _tare(content: object) -> KeptTare | None:
    try:
        return KeptTare.model_validate_json(json.dumps(content))
    except ValidationError:
        return None
