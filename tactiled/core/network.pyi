import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float32]

def tune(
    conditions: _Array, lowest: _Array, highest: _Array, hidden: _Array, last: _Array, out: _Array
) -> None: ...
def redraw(
    images: _Array, fixed: _Array, kernels: _Array, scales: _Array, offsets: _Array, draw: _Array, out: _Array
) -> None: ...
def hold(
    image: _Array,
    down: _Array,
    across: _Array,
    back: _Array,
    gain: _Array,
    c: _Array,
    firmness: float,
    out: _Array,
) -> None: ...
def misfit(
    image: _Array, down: _Array, across: _Array, gain: _Array, c: _Array, image_error: float, noise: float
) -> float: ...
