"""From the messages of one bus to the frames of its sensors, by id; pure."""

from collections.abc import Callable, Mapping

from tactiled.bus.assembler import Assembler
from tactiled.bus.codec import Codec
from tactiled.errors import ConfigError
from tactiled.frames import Message, RawFrame

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

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """Every (id, extended) that a sensor listens to."""
        return frozenset(self._owner)

    def push(self, message: Message, now: float | None = None) -> Frames:
        """Take one message, come at `now` (s; None: its own time); returns each (sensor, frame) that it closes."""
        name = self._owner.get((message.id, message.extended))
        if name is None:
            for assembler in self.assemblers.values():
                assembler.count("foreign")
            return ()
        assembler = self.assemblers[name]
        try:
            frames = assembler.push(assembler.codec.decode(message), now)
        except Exception:  # a CodecError of our codecs; another package's may raise anything
            assembler.count("malformed")
            return ()
        return tuple((name, frame) for frame in frames) if frames else ()

    def flush(self, before: float) -> Frames:
        """Close, marked, every frame whose newest message came before time `before` (s)."""
        return tuple((name, frame) for name, each in self.assemblers.items() for frame in each.flush(before))
