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
    linear: _Array,
    scale: float,
    fixed: _Array,
    kernels: _Array,
    tuned: _Array,
    draw: _Array,
    down: _Array,
    across: _Array,
    gain: _Array,
    c: _Array,
    noise: float,
    firm: tuple[float, float],
    within: tuple[int, int, int, int],
    images: _Array,
    out: _Array,
) -> None: ...
