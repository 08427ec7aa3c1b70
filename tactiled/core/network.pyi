import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]

def tune(
    conditions: _Array, lowest: _Array, highest: _Array, hidden: _Array, last: _Array, out: _Array
) -> None: ...
def redraw(
    images: _Array, fixed: _Array, kernels: _Array, scales: _Array, offsets: _Array, draw: _Array, out: _Array
) -> None: ...
def restore(
    images: _Array,
    fixed: _Array,
    kernels: _Array,
    tuned: _Array,
    draw: _Array,
    down: _Array,
    across: _Array,
    gain: _Array,
    c: _Array,
    firmness: _Array,
    within: tuple[int, int, int, int],
    out: _Array,
) -> None: ...
