"""From the messages of one bus to the frames of its sensors, by id; pure."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.assembler import Assembler
from tactiled.bus.batch import EXTENDED, Batch
from tactiled.bus.codec import Codec
from tactiled.errors import ConfigError
from tactiled.frames import Message, RawFrame

STRANGER = -1  # the owner of a message that belongs to no sensor
Frames = tuple[tuple[str, RawFrame], ...]


class Router:
    """Hands every message to the sensor that its id belongs to, and counts those that belong to none."""

    def __init__(
        self,
        codecs: Mapping[str, Codec],
        bus_counts: Callable[[], Mapping[str, int]] = dict,
        before: Mapping[str, Assembler] | None = None,
    ) -> None:
        """`bus_counts` gives what the bus itself counts, by the names of `Loss`; assemblers of `before` go on."""
        before = before or {}
        self.assemblers = {
            name: before.get(name) or Assembler(codec, bus_counts) for name, codec in codecs.items()
        }
        self._owner: dict[tuple[int, bool], str] = {}
        for name, codec in codecs.items():
            for key in codec.ids:
                if (other := self._owner.setdefault(key, name)) != name:
                    raise ConfigError(
                        f"sensors {other} and {name} both listen to id {key[0]:#x}: give each its own"
                    )
        keys = sorted((id_ | EXTENDED * extended, name) for (id_, extended), name in self._owner.items())
        self._keys = np.array([*(key for key, _ in keys), 0xFFFFFFFF], np.uint32)  # the last is no id
        self._names = list(self.assemblers)
        self._owners = np.array([*(self._names.index(name) for _, name in keys), STRANGER])
        self._by_key = {key: self._names.index(name) for key, name in keys}

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """Every (id, extended) that a sensor listens to."""
        return frozenset(self._owner)

    @property
    def needed(self) -> int:
        """How many messages more can make a frame whole at the earliest."""
        return min((each.needed for each in self.assemblers.values()), default=1)

    def push(self, batch: Batch | Message, now: float | NDArray[np.float64] | None = None) -> Frames:
        """Take messages, come at `now` (s; None: their own times); gives each (sensor, frame) that they close."""
        batch = Batch.of((batch,)) if isinstance(batch, Message) else batch
        if not len(batch):
            return ()
        first = self._by_key.get(int(batch.ids[0]), STRANGER)
        alike = first != STRANGER and np.count_nonzero(batch.ids == batch.ids[0]) == len(batch)
        owners = None if alike else self._owners_of(batch.ids)
        if owners is None or (first != STRANGER and np.count_nonzero(owners == first) == len(batch)):
            name = self._names[first]
            return tuple([(name, frame) for _, frame in self.assemblers[name].push(batch, now)])
        strangers = np.flatnonzero(owners == STRANGER)
        closed: list[tuple[int, str, RawFrame]] = []
        for number, (name, assembler) in enumerate(self.assemblers.items()):
            rows = np.flatnonzero(owners == number)
            if not (rows.size or strangers.size):
                continue
            own_now = now[rows] if isinstance(now, np.ndarray) else now
            frames = assembler.push(batch[rows], own_now, np.searchsorted(rows, strangers))
            closed += ((int(rows[row]), name, frame) for row, frame in frames)
        closed.sort(key=lambda each: each[0])
        return tuple((name, frame) for _, name, frame in closed)

    def _owners_of(self, ids: NDArray[np.uint32]) -> NDArray[np.int64]:
        """Number (n,) of the sensor of every id (n,)."""
        at = np.searchsorted(self._keys, ids)
        return np.where(self._keys[at] == ids, self._owners[at], STRANGER)

    def flush(self, before: float) -> Frames:
        """Close, marked, every frame whose newest message came before time `before` (s)."""
        return tuple((name, frame) for name, each in self.assemblers.items() for frame in each.flush(before))
