"""The errors a user can meet, by whose fault they are."""

from collections.abc import Iterable


class TactileError(Exception):
    """Anything tactiled refuses or fails at; the text is one line that names the thing and what to do."""


class ConfigError(TactileError):
    """A setting is wrong: the text names the key, the value and the bound."""


class PhysicsError(TactileError):
    """A cover that cannot be solved as asked: the text names the parameter and its value."""


class CodecError(TactileError):
    """A message on a sensor's own id that its codec cannot mean."""


class BusError(TactileError):
    """The CAN interface cannot be opened, read or written."""


class UnknownSensorError(TactileError):
    """A sensor name that the configuration does not have."""

    @classmethod
    def among(cls, name: str, there: Iterable[str]) -> "UnknownSensorError":
        """Of a name that is none of those there are; a long one is cut."""
        return cls(f"sensor {name[:80]!r}: no such sensor: there are {', '.join(there)}")


class NotLiveError(TactileError):
    """What needs frames that come, asked of a sensor that gets none."""


class LoadedError(TactileError):
    """A tare asked of an array that shows a load; `seen` says what it shows, and force tares anyway."""

    def __init__(self, text: str, seen: str) -> None:
        super().__init__(text)
        self.seen = seen


class NoShearError(TactileError):
    """Shear asked of a sensor whose skin feels none."""


class StateError(TactileError):
    """What a client wants kept cannot be written."""
