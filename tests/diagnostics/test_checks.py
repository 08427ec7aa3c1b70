import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tactiled.diagnostics.checks import CHECK_EVERY_FRAMES, CHECKS_IN_A_ROW, FrameChecks
from tactiled.frames import DEAD, SATURATED
from tactiled.restore.methods import make
from tactiled.simulate.array import FINER, Surface
from tests.bench.presses import presses
from tests.plans import plan

SIDE, NOISE = 20, 0.5
SOUND = np.zeros((SIDE, SIDE), np.uint8)


@pytest.fixture(scope="module")
def blur():
    return plan((SIDE, SIDE), 1.5, substrate=True, model="fem").blur


def sense(x=0.0, y=0.0, thickness=1.5, pressure=100.0, radius=2.4, noise=NOISE):
    """Frame of a punch at (x, y) mm from the middle, blurred exactly and drawn finer than the taxels."""
    wide = plan((3 * SIDE, 3 * SIDE), thickness, substrate=True)  # a punch past the edge presses there too
    surface = Surface(wide.kernel, wide.array)
    inside = np.clip(FINER * (radius - np.hypot(surface.x - x, surface.y - y)) + 0.5, 0, 1)
    frame = surface.sense(pressure * inside).reshape(3 * SIDE, 3 * SIDE)[SIDE : 2 * SIDE, SIDE : 2 * SIDE]
    return (frame + np.random.default_rng(5).normal(0, noise, frame.shape)).astype(np.float32)


def check(blur, frame, flags=SOUND, noise=NOISE):
    restore = make("nnls", blur, noise)
    image = restore(frame, flags).image
    return FrameChecks(blur).check(frame, flags, image, noise, predict=restore.predicted)


def stuck_taxel(frame):
    return np.where(np.arange(SIDE**2).reshape(SIDE, SIDE) == 10 * SIDE + 10, np.float32(0), frame)


def drifting_part(frame):
    drift = np.zeros_like(frame)
    drift[:5, -5:] = -0.7
    return frame + drift


@pytest.mark.parametrize(
    ("punch", "change", "codes"),
    [
        ({}, 0, ()),
        ({"x": -6, "y": 6.6}, 0, ()),
        ({"x": 1.5, "y": -2, "radius": 8}, 0, ()),  # on most of the array
        ({"pressure": 0}, 0, ()),
        ({"pressure": 0}, 1, ("offset",)),
        ({}, 5, ("offset",)),
        ({}, -0.8, ("negative",)),
        ({}, -3, ("negative", "cover_mismatch")),
        ({}, -12, ("negative", "cover_mismatch")),
        ({}, drifting_part, ("negative",)),
        ({}, stuck_taxel, ("outliers",)),
        ({}, lambda frame: np.minimum(frame, 55), ("plateau",)),
        ({"noise": NOISE * 2.5}, 0, ("negative",)),
        ({"noise": NOISE * 1.2}, 0, ()),
        ({"noise": NOISE * 0.7}, 0, ()),
        ({"noise": NOISE * 0.4}, 0, ("noise_low",)),
        ({"thickness": 0.25, "radius": 4}, 0, ("cover_mismatch",)),
        ({"x": 10.5}, 0, ()),  # half on the array: restored as it is
        ({"x": 11.5}, 0, ("edge",)),
        ({"x": -11, "y": 3}, 0, ("edge",)),
    ],
)
def test_codes_of_a_frame(blur, punch, change, codes):
    frame = sense(**punch)
    assert check(blur, change(frame) if callable(change) else frame + np.float32(change)) == codes


@pytest.mark.parametrize("place", [(0, 0), (3.3, -2.1), (-6, 6.6)])
@pytest.mark.parametrize(("noise", "offset"), [(4, 3), (10, 12)])
def test_an_offset_that_noise_hides_and_total_force_moves_onto_the_contact(blur, place, noise, offset):
    frame = sense(*place, noise=noise)
    assert check(blur, frame, noise=noise) == ()
    assert check(blur, frame + np.float32(offset), noise=noise) == ("offset",)


def test_an_image_stronger_than_its_frame_is_no_offset_where_parts_are_free(blur):
    frame = sense(noise=8.0)
    image = 1.5 * make("nnls", blur, 8.0)(frame).image
    assert FrameChecks(blur).check(frame, SOUND, image, 8.0) == ()
    assert FrameChecks(blur).check(frame + np.float32(5), SOUND, image, 8.0) == ("offset",)


@pytest.mark.parametrize("share", [lambda n: gaussian_filter(n, 1.5), lambda n: 0 * n + n[:, :1]])
def test_noise_that_taxels_share_is_low_in_fine_patterns(blur, share):
    noise = share(np.random.default_rng(3).normal(0, 1, (SIDE, SIDE)))
    frame = sense(noise=0.05) + (NOISE * noise / noise.std()).astype(np.float32)
    assert "noise_low" in check(blur, frame)


def test_rounding_to_counts_is_no_low_noise(blur):
    step = np.float32(4)
    frame, noise = np.round(sense(noise=0.01) / step) * step, step / 12**0.5
    image = make("nnls", blur, noise)(frame).image
    assert "noise_low" in FrameChecks(blur).check(frame, SOUND, image, noise)
    assert "noise_low" not in FrameChecks(blur, noise).check(frame, SOUND, image, noise)


def test_flagged_taxels_are_not_checked(blur):
    frame, flags = sense(), SOUND.copy()
    flags[::2, ::3] = DEAD
    frame[flags > 0] = np.nan
    assert check(blur, frame, flags) == ()
    saturated = np.minimum(sense(), 55)
    assert "plateau" not in check(blur, saturated, np.where(saturated >= 55, SATURATED, 0).astype(np.uint8))


def test_noise_alone_hardly_ever_raises_a_warning(blur):
    random, checks = np.random.default_rng(8), FrameChecks(blur)
    frames = random.normal(0, NOISE, (3000, SIDE, SIDE)).astype(np.float32)
    assert sum(bool(checks.check(each, SOUND, 0 * each, NOISE)) for each in frames) <= 3


def test_an_image_of_points_is_not_compared_with_its_frame(blur):
    frame, checks = sense(0.3, 0.2, radius=0.2, pressure=4e3), FrameChecks(blur)
    done = make("points", blur, NOISE)(frame)
    assert checks.check(frame, SOUND, done.image, NOISE, done.method) == ()
    assert checks.check(frame, SOUND, 2 * done.image, NOISE, "nnls") != ()


def test_a_raw_image_is_not_compared_with_its_frame():
    raw = 0
    for press in presses(16, (0.1,), (0.002,), 12, seed=31):
        if press.scene == "blobs":
            done = make("auto", press.blur, press.sigma)(press.frame)
            flags = np.zeros(press.frame.shape, np.uint8)
            assert FrameChecks(press.blur).check(press.frame, flags, done.image, press.sigma, done.method) == ()
            raw += done.method == "raw"
    assert raw


def test_a_warning_needs_several_checks_in_a_row(blur):
    checks, sound = FrameChecks(blur), sense()
    image = make("nnls", blur, NOISE)(sound).image.copy()
    raised = [
        [each.code for each in checks(sound - 3, SOUND, image, NOISE)]
        for _ in range(CHECK_EVERY_FRAMES * CHECKS_IN_A_ROW)
    ]
    first = CHECK_EVERY_FRAMES * (CHECKS_IN_A_ROW - 1)
    assert not any(raised[:first])
    assert all("negative" in codes for codes in raised[first:])
    assert not checks(sound, SOUND, image, NOISE)  # the next check no longer shows it
