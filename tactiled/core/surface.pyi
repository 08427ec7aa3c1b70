import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]
_Indices = NDArray[np.int64]

def box(
    y: _Array,
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    ends: tuple[int, int, int, int],
    shape: tuple[int, int],
    threshold: float,
    margin: int,
    noise: float,
    sigmas: float,
    hidden: float,
) -> tuple[int, int, int, int, bool]: ...
def complete(
    matrix: _Array,
    y: _Array,
    rows: _Indices,
    columns: _Indices,
    top: int,
    left: int,
    box: tuple[int, int, int, int],
    frame: _Array,
) -> None: ...
