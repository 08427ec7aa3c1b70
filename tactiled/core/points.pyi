import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]
_Places = NDArray[np.float64]

def peaks(
    image: _Array, reach: int, remainder: float, near: float, places: _Places
) -> tuple[int, int, float, float, float]: ...
def responses(down: _Array, across: _Array, at: NDArray[np.int64], first: int, out: _Array) -> None: ...
def fit(
    down: _Array,
    across: _Array,
    y: _Array,
    places: _Places,
    n: int,
    variance: float,
    steps: int,
    limits: _Places,
    jacobian: _Array,
    left: _Array,
    found: _Places,
) -> tuple[int, int, float, float]: ...
