"""The unit of each quantity.

The viewer's are in `web/static/units.js`; names of keys and fields end in them, too (`force_n`, `noise_kpa`).
"""

from typing import Literal

Pressure = Literal["kPa"]
Shear = Literal["counts"]
Unit = Literal[Pressure, Shear]  # of an image

PRESSURE: Pressure = "kPa"
SHEAR: Shear = "counts"
LENGTH, FORCE, STIFFNESS = "mm", "N", "MPa"
N_PER_KPA_MM2 = 1e-3  # force of a pressure on an area
