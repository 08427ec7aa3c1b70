import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]
_Flags = NDArray[np.uint8]
_Doubles = NDArray[np.float64]

def calibrate(
    counts: _Array,
    flags: _Flags,
    states: _Flags,
    zero: _Array,
    gain: _Array,
    added: _Array,
    saturation: float,
    unknown: int,
    saturated: int,
    pressure: _Array,
    out: _Flags,
) -> None: ...
def look(x: _Array) -> tuple[float, float, int]: ...
def keep_total(
    x: _Array,
    weight: _Array,
    total: float,
    likely: float,
    most_noise: float,
    agrees: float,
    clear: float,
    least: float,
    most: float,
    passes: int,
) -> None: ...
def compare(
    read: _Array, felt: _Array, flags: NDArray[np.uint8], noise: float, error: float, far: float
) -> tuple[int, float, float, int, float, float, int, float, float, float]: ...
def part_sums(x: _Array, rows: NDArray[np.int64], columns: NDArray[np.int64], out: _Doubles) -> None: ...
def raise_above(
    precision: _Doubles, right: _Doubles, bounds: _Doubles, sigma: float, sweeps: int, x: _Doubles
) -> None: ...
