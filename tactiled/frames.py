"""The values that pass from the bus to the browser, or to a calibration.

None is changed once it is made. RawFrame and SensorImage are not frozen: that would cost 4 µs in every frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.units import PRESSURE, Unit

MISSING = 1  # the taxel's message did not come
BAD = 2  # the sensor itself calls the taxel out of range or not connected
DEAD = 4  # the configuration or the calibration says that the taxel does not work
SATURATED = 8  # the taxel is at its ceiling: its pressure is a lower bound, not a value
OUT_OF_RANGE = 16  # the reading is beyond the calibrated range: its pressure is extrapolated
FAULTY = 32  # the service has found, while running, that the taxel does not work
BELOW_ZERO = 64  # the reading is far below zero, and no pressure pulls: its zero was taken under a load
FLAG_BITS = {
    "MISSING": MISSING, "BAD": BAD, "DEAD": DEAD, "SATURATED": SATURATED, "OUT_OF_RANGE": OUT_OF_RANGE,
    "FAULTY": FAULTY, "BELOW_ZERO": BELOW_ZERO,
}  # fmt: skip
UNKNOWN = MISSING | BAD | DEAD | FAULTY | BELOW_ZERO  # of such a taxel there is no pressure
LOST = MISSING | BELOW_ZERO  # of these, what a frame has lost: others are inferred in every frame
NOISE_UNKNOWN = "noise_unknown"  # the code of the warning of an image whose noise is not measured yet
UNSURE = 3.0  # times the median taxel: twice normal noise (1.48), as some cells are noisier than their mean
CONFIGURED = "configured"  # the calibration of an image where there is no calibration file


Direction = Literal["thinner", "thicker"]  # than configured
Counts: TypeAlias = NDArray[np.uint16 | np.float32]  # floats where a skin sends more than 16 bits, or a sign


class Message(NamedTuple):
    """One CAN data frame as codecs see it."""

    time: float  # s, the bus interface's clock (Unix time where the interface gives one)
    id: int
    data: bytes
    extended: bool = False
    fd: bool = False


class Reading(NamedTuple):
    """What one message carries, not yet unpacked, and which part of which frame it is."""

    time: float  # s
    segment: int  # 0 ... segments - 1
    payload: bytes  # the segment's taxels, as its codec packs them
    sequence: int | None = None  # modulo the codec's `modulus`; None where the skin sends none
    bad: tuple[int, ...] = ()  # taxels, by their index in the frame, that the sensor calls out of range


@dataclass(frozen=True, slots=True)
class Loss:
    """What went wrong on the way in, counted by kind since the reader started."""

    lost: int = 0  # messages that never came
    repeated: int = 0  # messages that came twice
    late: int = 0  # messages out of order: of a frame already closed, or behind a later segment
    foreign: int = 0  # messages on the bus that belong to no configured sensor
    malformed: int = 0  # messages on the sensor's id that its codec cannot mean
    incomplete: int = 0  # frames published with taxels missing
    skipped: int = 0  # frames not restored, because a newer one was already there
    dropped: int = 0  # messages that the kernel threw away, because they were not taken in time
    errors: int = 0  # error frames: what the bus interface says went wrong on the wire
    bus_off: int = 0  # times that the bus interface left the bus because of too many of them
    unsent: int = 0  # messages to skins, requests among them, that the bus did not take
    unreadable: int = 0  # messages that the interface could not decode; counted for every sensor of the bus
    undelivered: int = 0  # images that a reader published and that were lost, or overtaken, on their way


@dataclass(slots=True, eq=False)
class RawFrame:
    """One frame in counts; a missing taxel's count is 0 and its flag is MISSING."""

    sequence: int  # counts up without wrapping, lost frames included
    time: float  # s, of the frame's first message
    skew: float  # s, from the frame's first message to its last
    counts: Counts  # (N,)
    flags: NDArray[np.uint8]  # (N,) MISSING | BAD
    loss: Loss
    shear: NDArray[np.float32] | None = None  # counts from rest, (2, N) along x and y; None where none is felt
    arrived: float = 0.0  # s, when its newest message came, on a clock that never steps: for ages and windows
    references: NDArray[np.float32] | None = None  # (M,) counts of pads that feel no pressure; NaN where missing


@dataclass(frozen=True, slots=True)
class FrameWarning:
    """Something known against an image."""

    code: str  # one of `diagnostics.warning_codes`: programs compare this
    text: str  # for people
    taxels: int | None = None  # how many it is about; None where that does not apply
    thickness_mm: float | None = None  # of the cover that explains a `cover_mismatch`, where one does
    direction: Direction | None = None  # of the real cover, where it has one
    interval_mm: tuple[float, float] | None = None  # 95 % of the thickness; None: it is at most `thickness_mm`


class StageTimes(NamedTuple):
    """When a frame had passed each stage on its way to an image, s, on a clock that never steps."""

    first_message: float  # it had come, by the bus's clock before the last one
    last_message: float  # it had come; of a recording, it was read
    assembled: float  # it had been decoded and was handed to its sensor
    started: float  # it was its turn
    calibrated: float  # it was in `unit`
    restored: float
    checked: float  # its warnings were known


@dataclass(slots=True, eq=False)
class SensorImage:
    """One frame of pressures, as measured and as restored, with everything known against it."""

    sensor: str
    sequence: int
    time: float  # s, of the frame's first message
    raw: NDArray[np.float32]  # in `unit`, (R, C) for a grid, (N,) for any other layout; NaN where nothing is known
    restored: NDArray[np.float32]  # the same on the cells of a `geometry.Raster`; NaN where unknown or not felt
    flags: NDArray[np.uint8]  # the raw image's shape: of FLAG_BITS
    method: str  # what ran: idle, raw, wiener, rl, nnls, ...
    why: str  # why it was chosen
    iterations: int
    microseconds: float  # spent from counts to restored image
    noise: float  # standard deviation of one raw taxel, in `unit`
    noise_gain: float  # restored noise over raw noise
    resolution_mm: float  # the finest half-period that the restored image carries above its noise
    loss: Loss = field(default_factory=Loss)
    warnings: tuple[FrameWarning, ...] = ()
    shear: NDArray[np.float32] | None = None  # counts, x and y of the raw image's shape; as sensed, NaN as there
    arrived: float = 0.0  # s, as of its frame
    unit: Unit = PRESSURE  # of raw, restored and noise: counts without a calibration
    calibration: str = CONFIGURED  # id of the calibration file that it was made with: 12 hex digits
    times: StageTimes | None = None  # None where it was made elsewhere
    traction: NDArray[np.float32] | None = None  # kPa, tangential load along x and y (2, rows, columns), restored
    traction_deviation: NDArray[np.float32] | None = None  # kPa, its standard deviation
    tilt: NDArray[np.float32] | None = None  # kPa of `raw` that comes of it; None: nothing does
    shares: NDArray[np.float32] | None = None  # of each cell, by `contacts.felt`; None where no message is lost

    @property
    def noise_known(self) -> bool:
        """Whether the noise was measured, or is configured."""
        return all(each.code != NOISE_UNKNOWN for each in self.warnings)

    @property
    def cell_noise(self) -> float:
        """Standard deviation of a restored cell, in `unit`; a safe bound of it as long as the noise is unknown.

        Then all that the taxels show may be noise.
        """
        noise = self.noise
        if not self.noise_known:
            finite = self.raw[np.isfinite(self.raw)].astype(float)
            noise = max(noise, UNSURE * float(np.median(np.abs(finite))) if finite.size else 0.0)
        return noise * max(self.noise_gain, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class FrameSeries:
    """Frames of one array in counts, in the order of their times, as a calibration takes them."""

    times: Floats  # (T,) s, of each frame's first message
    counts: Floats32  # (T, N); NaN where a taxel is unknown

    def without(self, taxels: Sequence[int]) -> Self:
        """The same where nothing is known of some taxels."""
        counts = self.counts.copy()
        counts[:, list(taxels)] = np.nan
        return replace(self, counts=counts)
