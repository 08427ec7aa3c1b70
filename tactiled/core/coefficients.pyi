import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]
_Whole = NDArray[np.int64]

def transform(left: _Array, x: _Array, right: _Array, out: _Array) -> None: ...
def likeliest(
    left: _Array, frame: _Array, right: _Array, row_blocks: _Whole, column_blocks: _Whole, costs: _Array
) -> int: ...
def outstanding(
    squares: _Array,
    variance: float,
    limit: _Array,
    quiet: _Array,
    down: _Array,
    across: _Array,
    inverse: _Array,
    firm: _Array,
    weight: _Array,
    out: _Array,
) -> bool: ...
def signed_sums(x: _Array) -> tuple[float, float, float, float]: ...
