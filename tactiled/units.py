"""The unit of each quantity; that of pressure and force follows the calibration of their sensor.

The viewer's are in `web/static/shell/units.js`; names of keys and fields end in them, too (`force_n`,
`noise_kpa`), and hold nothing in counts.
"""

from typing import Literal

Pressure = Literal["kPa"]
Unit = Literal["kPa", "counts"]  # of an image: counts of pressure without a calibration, and of shear
ForceUnit = Literal["N", "counts mm2"]
Shear = Literal["counts"]

PRESSURE: Pressure = "kPa"  # of a sensor that is calibrated
COUNTS: Literal["counts"] = "counts"  # of pressure and shear that are not; above zero under a load
SHEAR: Shear = COUNTS
LENGTH, FORCE, STIFFNESS = "mm", "N", "MPa"
M_PER_MM = 1e-3
N_PER_KPA_MM2 = 1e-3  # force of a pressure on an area
FORCE_UNITS: dict[Unit, ForceUnit] = {PRESSURE: "N", COUNTS: "counts mm2"}
FORCE_SCALES: dict[Unit, float] = {PRESSURE: N_PER_KPA_MM2, COUNTS: 1.0}  # force of a pressure of 1 on 1 mm2


def if_calibrated(value: float, unit: Unit) -> float | None:
    """A value for a key that ends in kPa or N; None where it is in counts."""
    return None if unit == COUNTS else value


def nanoseconds(seconds: float) -> int:
    """A time as Foxglove and ROS have it."""
    return round(seconds * 1e9)


def number_text(value: float) -> str:
    """Three significant digits, or more where a whole number has more."""
    return f"{value:#.3g}".rstrip(".") if abs(value) < 100 else f"{value:.0f}"


def force_text(force: float, unit: Unit) -> str:
    """The force of a contact for people, from an image in `unit`."""
    return f"{force:.{2 if unit == PRESSURE else 0}f} {FORCE_UNITS[unit]}"
