from typing import Any

import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]
_Whole = NDArray[np.int64]
_Times = NDArray[np.float64]

def well_formed(
    data: _Bytes,
    lengths: _Bytes,
    kinds: _Bytes,
    kind: int,
    expected: _Bytes,
    padding: _Bytes,
    first: int,
    sequences: _Whole,
    segments: _Whole,
    good: _Bytes,
) -> int: ...
def unpack(payloads: _Bytes, bits: int, taxels: int, out: NDArray[np.uint16]) -> None: ...
def run(
    segments: _Whole,
    sequences: _Whole | None,
    times: _Times,
    came: _Times | None,
    at: int,
    present: NDArray[Any],
    missing: int,
    ordered: int,
    rank: _Whole | None,
    length: int,
) -> tuple[int, float, float, float, float, int]: ...
