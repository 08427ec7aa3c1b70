"""Every skin that must be started or asked against a board that answers as its source says."""

import numpy as np
import pytest

from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.linker_l30 import LinkerL30
from tactiled.bus.codecs.omnihand import OmniHand
from tactiled.bus.codecs.xela import Xela
from tactiled.frames import BAD
from tests.bus.boards import (
    LinkerHand,
    LinkerL30Hand,
    LinkerO20,
    Mtb,
    OmniHand2025,
    TactilePuck,
    XelaOlder,
    frames_of,
)


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


@pytest.mark.parametrize(
    ("layout", "poll_hz", "pause_s"),
    [("10x4", 20.0, 0.0025), ("g20-5", 1.0, 0.015), ("g20-5", 20.0, 0.01), ("o20", 20.0, 0.0)],
)
def test_a_linker_hand_gets_its_requests_one_after_the_other(layout, poll_hz, pause_s):
    polls = Linker("right", (1, 2, 3, 4, 5), poll_hz, layout).polling.polls
    after_s = [each.after_s for each in polls][:: len(polls) // 5]
    assert after_s == pytest.approx([pause_s * n for n in range(5)])


@pytest.mark.parametrize(
    ("layout", "fingers", "shapes"),
    [
        ("12x6", (1, 4), [(12, 6)] * 2),
        ("10x4", (5, 2), [(10, 4)] * 2),
        ("g20-5", (2, 6), [(23, 9), (28, 20)]),
        ("g20-7", (6, 1), [(14, 16), (12, 6)]),
        ("o20", (1, 5), [(12, 6)] * 2),
    ],
)
def test_a_linker_hand_answers_its_requests_with_every_taxel(layout, fingers, shapes):
    rng = np.random.default_rng(3)
    matrices = {each: rng.integers(0, 256, shape, np.uint8) for each, shape in zip(fingers, shapes, strict=True)}
    board = LinkerO20(1, matrices) if layout == "o20" else LinkerHand(0x27, matrices)
    frames = frames_of(Linker("right", fingers, 20.0, layout), board, 0.18)
    assert len(frames) == 4
    for frame in frames:
        np.testing.assert_array_equal(frame.counts, np.concatenate([each.ravel() for each in matrices.values()]))
        assert not frame.flags.any()


RNG = np.random.default_rng(4)
THUMB, LITTLE = RNG.integers(0, 256, (2, 12, 6), np.uint8)
CELLS = RNG.integers(0, 0x1000, 24).tolist()
TIP, PALM = bytes(range(1, 17)), bytes(range(50, 75))


@pytest.mark.parametrize(
    ("codec", "board", "counts", "frames"),
    [
        (LinkerL30(3, (5, 1)), LinkerL30Hand(3, {1: THUMB, 5: LITTLE}), [*LITTLE.ravel(), *THUMB.ravel()], 4),
        (Barrett(11, 20.0), TactilePuck(11, CELLS), CELLS, 5),  # one to the setting of its full format
        (OmniHand(3, "left", (4, 6)), OmniHand2025(3, {4: TIP, 6: PALM}), [*TIP[::-1], *PALM], 4),
    ],
)
def test_a_board_answers_every_request_with_every_taxel(codec, board, counts, frames):
    got = frames_of(codec, board, 0.18)
    assert [each.counts.tolist() for each in got] == [counts] * frames
    assert not np.any([each.flags for each in got])


def test_an_older_xela_board_is_started_and_stopped():
    axes = np.random.default_rng(5).integers(0, 1 << 16, (16, 3)).astype(">u2")
    board = XelaOlder(3, axes)
    (frame,) = frames_of(Xela("4x4-old", 3, start=True), board, 0.1)
    assert (frame.counts.tolist(), board.sends) == (axes[:, 2].tolist(), False)
