"""Every skin that must be started or asked against a board that answers as its source says."""

import numpy as np
import pytest

from tactiled.bus.codecs.icub import Icub
from tactiled.frames import BAD
from tests.bus.boards import Mtb, frames_of


@pytest.mark.parametrize(
    ("shift", "counts", "bad"),
    [(2, [190, 140, 115, 240], []), (1, [140, 40, 0, 240], []), (0, [40, 0, 0, 240], [2])],
)
def test_an_mtb_board_gets_the_gain_that_is_configured(shift, counts, bad):
    codec = Icub(13, (5,), start=True, shift=shift)
    board = Mtb(13, {5: [200, 400, 500, *[0] * 9]})
    (frame,) = frames_of(codec, board, 1.0)
    assert frame.counts[:4].tolist() == counts
    assert np.flatnonzero(frame.flags & BAD).tolist() == bad
    assert (board.no_load, board.sends) == (codec.no_load, False)
