"""Whether presses suffice for a calibration, and where more are needed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats
from tactiled.geometry import Array

ZONES_A_SIDE = 3
ZONES = (
    ("in the top left corner", "at the top border", "in the top right corner"),
    ("at the left border", "in the middle", "at the right border"),
    ("in the bottom left corner", "at the bottom border", "in the bottom right corner"),
)
MAX_ZONES_NAMED = 2  # in a line of advice


@dataclass(frozen=True, slots=True)
class Need:
    """What a way of calibrating needs of `unit`s, such as presses."""

    unit: str  # singular
    count: int
    per_zone: int = 0


@dataclass(frozen=True, slots=True)
class Quality:
    """What the frames of a calibration under way are good for."""

    advice: str  # one line: how many presses, where more are needed
    enough: bool
    presses: int = 0
    presses_needed: int = 0
    presses_saturated: int = 0
    last_unused: str = ""  # why the last press is not used
    zones: tuple[tuple[int, ...], ...] = ()  # presses in 3 x 3 zones of the array, rows from the top
    zone_presses_needed: int = 0


def zone_counts(places: Floats, array: Array) -> NDArray[np.int64]:
    """Number of `places` (P, 2) in mm in each of 3 x 3 zones of an array; one outside is in the nearest."""
    low, high = array.positions.min(axis=0), array.positions.max(axis=0)
    half = array.pitch / 2
    shares = (np.reshape(places, (-1, 2)) - (low - half)) / (high - low + 2 * half)
    columns, rows = np.clip((shares * ZONES_A_SIDE).astype(int), 0, ZONES_A_SIDE - 1).T
    counts = np.zeros((ZONES_A_SIDE, ZONES_A_SIDE), np.int64)
    np.add.at(counts, (rows, columns), 1)
    return counts


def enough(count: int, zones: NDArray[np.int64], need: Need) -> bool:
    """Whether nothing more is needed."""
    return count >= need.count and bool((zones >= need.per_zone).all())


def advice(count: int, zones: NDArray[np.int64], need: Need) -> str:
    """Progress in one line, such as "12 of 20 presses; enough in the middle, none at the left border"."""
    plural = need.unit + ("es" if need.unit.endswith("s") else "s")
    if enough(count, zones, need):
        return f"{count} {plural}: enough"
    begin = f"{count} of {need.count} {plural}"
    missing = [
        (int(zones[at]), ZONES[at[0]][at[1]]) for at in np.ndindex(zones.shape) if zones[at] < need.per_zone
    ]
    if not count or not missing:
        return begin
    parts = ["enough in the middle"] if need.per_zone <= zones[1, 1] else []
    for number in sorted({number for number, _ in missing}):
        names = [name for each, name in missing if each == number]
        more = len(names) - MAX_ZONES_NAMED
        others = f" and in {more} more zone{'s' if more > 1 else ''}" if more > 0 else ""
        parts.append(f"{number or 'none'} {', '.join(names[:MAX_ZONES_NAMED])}{others}")
    return f"{begin}; {', '.join(parts)}"
