import numpy as np
import pytest

from tactiled.cover.kernel import solve
from tactiled.cover.operator import stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.doubt import EDGE, EVERY, IN_A_ROW, NEGATIVE, OUTLIER, PLATEAU, RESIDUAL, Doubt
from tactiled.frames import SATURATED
from tactiled.geometry import grid
from tactiled.restore.blur import Blur
from tactiled.restore.methods import make
from tactiled.simulate.array import FINER, Surface

SIDE, NOISE = 20, 0.5
RUBBER = (0.6, 0.48)


@pytest.fixture(scope="module")
def array():
    return grid(SIDE, SIDE, 1.0, 0.8)


@pytest.fixture(scope="module")
def blur(array):
    kernel = solve(Stack((Layer(1.5, *RUBBER), Layer(1.0, 980.0, 0.3))), "fem")
    return Blur.grid(stencil(kernel, array), (SIDE, SIDE))


@pytest.fixture(scope="module")
def felt():
    """What the taxels feel of a punch at (x, y) mm from the middle, blurred exactly and four times finer."""

    def felt(x, y, thickness=1.5, pressure=100.0, radius=2.4):
        wide = grid(3 * SIDE, 3 * SIDE, 1.0, 0.8)  # a punch past the edge presses there too
        surface = Surface(solve(Stack((Layer(thickness, *RUBBER), Layer(1.0, 980.0, 0.3))), "layered"), wide)
        inside = np.clip(FINER * (radius - np.hypot(surface.x - x, surface.y - y)) + 0.5, 0, 1)
        all_ = surface.sense(pressure * inside).reshape(3 * SIDE, 3 * SIDE)
        noise = np.random.default_rng(5).normal(0, NOISE, (SIDE, SIDE))
        return (all_[SIDE : 2 * SIDE, SIDE : 2 * SIDE] + noise).astype(np.float32)

    return felt


def look(blur, frame, flags=None, noise=NOISE):
    flags = np.zeros(frame.shape, np.uint8) if flags is None else flags
    return Doubt(blur).look(frame, flags, make("nnls", blur, noise)(frame, flags).image, noise)


@pytest.mark.parametrize("place", [(0, 0), (3.3, -2.1), (-6, 6.6)])
def test_a_sound_frame_raises_no_doubt(blur, felt, place):
    assert look(blur, felt(*place)) == ()


def test_an_idle_frame_raises_none_either(blur):
    idle = np.random.default_rng(0).normal(0, NOISE, (SIDE, SIDE)).astype(np.float32)
    assert look(blur, idle) == ()


def test_a_taxel_that_stays_behind(blur, felt):
    frame = felt(0, 0)
    frame[10, 10] = 0
    assert look(blur, frame) == (OUTLIER,)


def test_an_offset_below_zero(blur, felt):
    assert NEGATIVE in look(blur, felt(0, 0) - 12)


def test_a_ceiling_that_nobody_told(blur, felt):
    frame = np.minimum(felt(0, 0), 55)
    assert PLATEAU in look(blur, frame)
    assert PLATEAU not in look(blur, frame, np.where(frame >= 55, SATURATED, 0).astype(np.uint8))


def test_a_cover_that_is_another(blur, felt):
    assert look(blur, felt(0, 0, thickness=0.4)) == (RESIDUAL,)


@pytest.mark.parametrize("place", [(10.5, 0), (0, -10.5), (-11, 3)])
def test_a_contact_over_the_edge(blur, felt, place):
    assert EDGE in look(blur, felt(*place))


def test_nothing_is_said_before_it_was_seen_several_times_running(blur, felt):
    doubt, sound = Doubt(blur), felt(0, 0)
    image = make("nnls", blur, NOISE)(sound).image.copy()
    bad, flags = sound - 12, np.zeros((SIDE, SIDE), np.uint8)
    said = [bool(doubt(bad, flags, image, NOISE)) for _ in range(EVERY * IN_A_ROW)]
    assert said == [False] * (EVERY * (IN_A_ROW - 1)) + [True] * EVERY
    assert not doubt(sound, flags, image, NOISE)  # and no longer than it is seen
