import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.diagnostics.checks import CHECK_EVERY_FRAMES, CHECKS_IN_A_ROW, FrameChecks
from tactiled.frames import DEAD, SATURATED
from tactiled.geometry import grid
from tactiled.restore.methods import make
from tactiled.simulate.array import FINER, Surface
from tests.plans import plan
from tests.study.presses import presses

SIDE, NOISE = 20, 0.5
RUBBER = (0.6, 0.48)


@pytest.fixture(scope="module")
def array():
    return grid(SIDE, SIDE, 1.0, 0.8)


@pytest.fixture(scope="module")
def blur():
    return plan((SIDE, SIDE), 1.5, substrate=True, model="fem").blur


@pytest.fixture(scope="module")
def felt():
    """What the taxels feel of a punch at (x, y) mm from the middle, blurred exactly and four times finer."""

    def felt(x, y, thickness=1.5, pressure=100.0, radius=2.4, noise=NOISE):
        wide = grid(3 * SIDE, 3 * SIDE, 1.0, 0.8)  # a punch past the edge presses there too
        surface = Surface(solve(Stack((Layer(thickness, *RUBBER), Layer(1.0, 980.0, 0.3))), "layered"), wide)
        inside = np.clip(FINER * (radius - np.hypot(surface.x - x, surface.y - y)) + 0.5, 0, 1)
        all_ = surface.sense(pressure * inside).reshape(3 * SIDE, 3 * SIDE)
        white = np.random.default_rng(5).normal(0, noise, (SIDE, SIDE))
        return (all_[SIDE : 2 * SIDE, SIDE : 2 * SIDE] + white).astype(np.float32)

    return felt


def look(blur, frame, flags=None, noise=NOISE):
    flags = np.zeros(frame.shape, np.uint8) if flags is None else flags
    return FrameChecks(blur).check(frame, flags, make("nnls", blur, noise)(frame, flags).image, noise)


@pytest.mark.parametrize("place", [(0, 0), (3.3, -2.1), (-6, 6.6)])
def test_a_sound_frame_raises_no_doubt(blur, felt, place):
    assert look(blur, felt(*place)) == ()


def test_an_idle_frame_raises_none_either(blur):
    idle = np.random.default_rng(0).normal(0, NOISE, (SIDE, SIDE)).astype(np.float32)
    assert look(blur, idle) == ()


def test_a_taxel_that_stays_behind(blur, felt):
    frame = felt(0, 0)
    frame[10, 10] = 0
    assert look(blur, frame) == ("outliers",)


def test_an_offset_below_zero(blur, felt):
    assert "negative" in look(blur, felt(0, 0) - 12)


@pytest.mark.parametrize("offset", [-0.8, -3])
def test_a_faint_offset_below_zero_shows_in_what_is_not_pressed(blur, felt, offset):
    assert "negative" in look(blur, felt(0, 0) + np.float32(offset))


def test_a_part_of_the_array_that_drifts_below_zero(blur, felt):
    frame = felt(0, 0)
    frame[:5, -5:] -= np.float32(0.7)
    assert look(blur, frame) == ("negative",)


def test_an_offset_above_zero_leaves_no_part_free(blur, felt):
    assert look(blur, felt(0, 0) + np.float32(5)) == ("offset",)
    idle = np.random.default_rng(0).normal(1.0, NOISE, (SIDE, SIDE)).astype(np.float32)
    assert look(blur, idle) == ("offset",)


@pytest.mark.parametrize("place", [(0, 0), (3.3, -2.1), (-6, 6.6)])
@pytest.mark.parametrize(("noise", "offset"), [(4, 3), (8, 7), (10, 7)])
def test_an_offset_that_noise_hides_and_total_force_moves_onto_the_contact(blur, felt, place, noise, offset):
    frame = felt(*place, noise=noise)
    assert look(blur, frame, noise=noise) == ()
    assert look(blur, frame + np.float32(offset), noise=noise) == ("offset",)


def test_an_image_stronger_than_its_frame_is_no_offset_where_parts_are_free(blur, felt):
    frame, flags = felt(0, 0, noise=8.0), np.zeros((SIDE, SIDE), np.uint8)
    image = 1.5 * make("nnls", blur, 8.0)(frame).image
    assert FrameChecks(blur).check(frame, flags, image, 8.0) == ()
    assert FrameChecks(blur).check(frame + np.float32(5), flags, image, 8.0) == ("offset",)


def test_a_press_on_most_of_the_array_is_no_offset(blur, felt):
    assert look(blur, felt(1.5, -2, radius=8)) == ()


@pytest.mark.parametrize(("true", "said"), [(2.5, ("negative",)), (1.2, ()), (0.7, ()), (0.4, ("noise_low",))])
def test_noise_that_is_not_as_told(blur, felt, true, said):
    assert look(blur, felt(0, 0), noise=NOISE / true) == said


@pytest.mark.parametrize("shared", [lambda n: gaussian_filter(n, 1.5), lambda n: 0 * n + n[:, :1]])
def test_noise_that_taxels_share(blur, felt, shared):
    noise = shared(np.random.default_rng(3).normal(0, 1, (SIDE, SIDE)))
    frame = felt(0, 0, noise=0.05) + (NOISE * noise / noise.std()).astype(np.float32)
    assert "noise_low" in look(blur, frame)


def test_rounding_to_counts_is_no_noise_that_is_missing(blur, felt):
    step = np.float32(4)
    frame = np.round(felt(0, 0, noise=0.01) / step) * step
    image = make("nnls", blur, step / 12**0.5)(frame).image
    flags = np.zeros(frame.shape, np.uint8)
    assert "noise_low" in FrameChecks(blur).check(frame, flags, image, step / 12**0.5)
    assert "noise_low" not in FrameChecks(blur, step / 12**0.5).check(frame, flags, image, step / 12**0.5)


def test_flagged_taxels_raise_no_doubt_about_the_noise(blur, felt):
    frame, flags = felt(0, 0), np.zeros((SIDE, SIDE), np.uint8)
    flags[::2, ::3] = DEAD
    frame[flags > 0] = np.nan
    assert look(blur, frame, flags) == ()


def test_noise_alone_hardly_ever_raises_a_doubt(blur):
    random, doubt, flags = np.random.default_rng(8), FrameChecks(blur), np.zeros((SIDE, SIDE), np.uint8)
    noise = random.normal(0, NOISE, (3000, SIDE, SIDE)).astype(np.float32)
    assert sum(bool(doubt.check(each, flags, 0 * each, NOISE)) for each in noise) <= 3


def test_points_are_not_held_against_the_cells_that_they_are_drawn_on(blur, felt):
    frame, flags = felt(0.3, 0.2, radius=0.2, pressure=4e3), np.zeros((SIDE, SIDE), np.uint8)
    done = make("points", blur, NOISE)(frame)
    doubt = FrameChecks(blur)
    assert doubt.check(frame, flags, done.image, NOISE, done.method) == ()
    assert doubt.check(frame, flags, 2 * done.image, NOISE, "nnls") != ()


def test_what_is_left_raw_is_not_held_against_its_blur():
    """Points that nothing tells from pairs are left raw: eight of these came with a warning of dead taxels."""
    left = 0
    for press in presses(16, (0.5,), (0.002,), 12, seed=31):
        if press.scene == "points":
            done = make("auto", press.blur, press.sigma)(press.frame)
            flags = np.zeros(press.frame.shape, np.uint8)
            assert FrameChecks(press.blur).check(press.frame, flags, done.image, press.sigma, done.method) == ()
            left += done.method == "raw"
    assert left


def test_a_ceiling_that_nobody_told(blur, felt):
    frame = np.minimum(felt(0, 0), 55)
    assert "plateau" in look(blur, frame)
    assert "plateau" not in look(blur, frame, np.where(frame >= 55, SATURATED, 0).astype(np.uint8))


def test_a_cover_that_is_another(blur, felt):
    assert look(blur, felt(0, 0, thickness=0.25, radius=4.0)) == ("cover_mismatch",)


@pytest.mark.parametrize("place", [(10.5, 0), (0, -10.5), (-11, 3)])
def test_a_contact_over_the_edge(blur, felt, place):
    assert "edge" in look(blur, felt(*place))


def test_nothing_is_said_before_it_was_seen_several_times_running(blur, felt):
    doubt, sound = FrameChecks(blur), felt(0, 0)
    image = make("nnls", blur, NOISE)(sound).image.copy()
    bad, flags = sound - 12, np.zeros((SIDE, SIDE), np.uint8)
    said = [bool(doubt(bad, flags, image, NOISE)) for _ in range(CHECK_EVERY_FRAMES * CHECKS_IN_A_ROW)]
    assert said == [False] * (CHECK_EVERY_FRAMES * (CHECKS_IN_A_ROW - 1)) + [True] * CHECK_EVERY_FRAMES
    assert not doubt(sound, flags, image, NOISE)  # and no longer than it is seen
