"""The errors that a user can meet, by their cause."""

from collections.abc import Iterable


class TactileError(Exception):
    """Anything that tactiled refuses or fails at; the text is one line: what is wrong, and what to do."""


class ConfigError(TactileError):
    """A setting is wrong: the text names the key, the value and the bound."""


class PhysicsError(TactileError):
    """A cover cannot be solved: the text names the parameter and its value."""


class CodecError(TactileError):
    """A message on a sensor's own id does not fit its layout."""


class BusError(TactileError):
    """The CAN interface cannot be opened, read or written."""


class UnknownSensorError(TactileError):
    """A sensor name that the configuration does not have."""

    @classmethod
    def among(cls, name: str, configured: Iterable[str]) -> "UnknownSensorError":
        """The error for a name that is not configured; a long one is cut."""
        return cls(f"sensor {name[:80]!r}: no such sensor: there are {', '.join(configured) or 'none'}")


class NotLiveError(TactileError):
    """A request needs live frames, and the sensor gets none."""


class LoadedError(TactileError):
    """A tare of an array that shows a load, which `seen` describes; force tares anyway."""

    def __init__(self, text: str, seen: str) -> None:
        super().__init__(text)
        self.seen = seen


class NotPushedError(TactileError):
    """Frames are pushed into a sensor that reads a bus, or a recording."""


class NoShearError(TactileError):
    """Shear of a sensor whose skin measures none."""


class StateError(TactileError):
    """The state file, or a calibration file, cannot be written."""


class ReaderError(TactileError):
    """A sensor's reader, on another machine, cannot be reached or fails."""


class ReaderAnswerError(TactileError):
    """A sensor's reader answers what no reader of this release does."""


class ReadOnlyError(TactileError):
    """A change at a sensor's reader, which this server has no right to."""


class ReloadError(TactileError):
    """A service that cannot read its configuration again."""


class TareStateError(TactileError):
    """There is no tare to undo."""


class CalibrationStateError(TactileError):
    """A calibration session does not allow this now."""


class NoCalibrationError(TactileError):
    """A sensor without a calibration session."""
