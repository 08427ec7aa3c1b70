import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]
_Places = NDArray[np.float64]

def peaks(
    image: _Array, reach: int, remainder: float, near: float, places: _Places
) -> tuple[int, int, float, float, float]: ...
def responses(down: _Array, across: _Array, at: NDArray[np.int64], first: int, out: _Array) -> None: ...
def step(gram: _Places, along: _Places, ridge: float, out: _Places) -> None: ...
