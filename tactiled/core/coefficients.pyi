import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]
_Whole = NDArray[np.int64]

def transform(left: _Array, x: _Array, right: _Array, out: _Array) -> None: ...
def likeliest(
    left: _Array, frame: _Array, right: _Array, row_blocks: _Whole, column_blocks: _Whole, costs: _Array
) -> int: ...
def analyse(left: _Array, x: _Array, right: _Array, total: _Array, out: _Array) -> tuple[float, float]: ...
def filtered(
    c: _Array,
    variance: float,
    of_spectrum: _Array,
    of_modes: _Array,
    shared: _Array,
    total: _Array,
    left: _Array,
    right: _Array,
    weight: _Array,
    out: _Array,
) -> tuple[float, float, float, float, float, float]: ...
