import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]
_Labels = NDArray[np.int64]

def split(
    picture: _Array,
    order: _Labels,
    high_near: _Array,
    least: _Array,
    was: _Labels,
    shares: tuple[float, float, float],
    skirt: float,
    parts: _Labels,
) -> None: ...
def widen(parts: _Labels, picture: _Array, skirts: _Labels) -> None: ...
