"""What a frame that lost messages still tells: the rule by which a cell, a region or a contact is unknown.

The share of a cell that is left is H'a / H'1: what the taxels with a = 1 feel of it. a = 0 where a message is
lost, or a reading is too far below zero to be a pressure.
"""

from functools import lru_cache

import numpy as np

from tactiled.arrays import Flags, Floats32, Mask, Reals
from tactiled.frames import BELOW_ZERO, LOST, UNKNOWN
from tactiled.restore.blur import Blur
from tactiled.restore.scene import MIN_REACH

# `python -m tests.bench felt` measures what is wrong at each share.
MIN_CELL_SHARE = 0.4  # with less an image misses a third of the pressure on a cell, or more
MIN_SUM_SHARE = 0.8  # of a region or contact without an unknown cell, whose force is then right to 15 %
KEPT_SHARES = 64  # patterns of lost taxels: those that never come are the same in each frame


def is_known(share: Reals | np.floating | float, summed: bool = False) -> Mask:
    """Whether enough is left (0 ... 1) of a cell, or of a region or contact, `summed` over cells."""
    return np.asarray(share) >= (MIN_SUM_SHARE if summed else MIN_CELL_SHARE)


def shares(flags: Flags, blur: Blur) -> Floats32 | None:
    """The share of each cell that a frame with these flags has; None where none is lost.

    Dead or faulty taxels, unless all are, do not count as lost: they are restored from their neighbours.
    """
    if not np.count_nonzero(flags):
        return None
    if (flags & UNKNOWN != 0).all():
        return np.zeros(blur.surface_shape, np.float32)
    return _left(flags, LOST, blur)


def unknown_cells(flags: Flags, blur: Blur, share: Floats32) -> Mask:
    """Which cells are unknown, by their `shares`; also those of a wrong zero, as nothing is inferred there."""
    wrong = _left(flags, BELOW_ZERO, blur)
    unknown = ~is_known(share)
    return unknown if wrong is None else unknown | ~is_known(wrong, summed=True)


def _left(flags: Flags, kinds: int, blur: Blur) -> Floats32 | None:
    lost = flags & kinds != 0
    return _shares(lost.tobytes(), blur) if lost.any() else None


@lru_cache(KEPT_SHARES)
def _shares(lost: bytes, blur: Blur) -> Floats32:
    left = 1 - np.frombuffer(lost, np.bool_).reshape(blur.frame_shape).astype(np.float32)
    felt = blur.reach > MIN_REACH * blur.reach.max()
    share = np.clip(np.divide(blur.adjoint(left), blur.reach, out=np.zeros_like(blur.reach), where=felt), 0, 1)
    share.flags.writeable = False
    return share
