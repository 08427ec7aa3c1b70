import numpy as np
import pytest

from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED
from tactiled.restore.methods import METHODS, make
from tactiled.study.skin import clips, rubber
from tests.study.presses import presses

SIGMA = 0.5
SHARP = [name for name in METHODS if name != "raw"]
LAYOUTS = [pytest.param(False, id="grid"), pytest.param(True, id="layout")]


def error(image, truth):
    return np.linalg.norm(image - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("method", SHARP)
def test_a_restored_image_is_nearer_the_truth_than_the_raw_one(covered, pressed, method, layout):
    blur = covered(layout=layout)
    frame, truth = pressed(blur, SIGMA)
    done = make(method, blur, SIGMA)(frame)
    assert done.image.shape == blur.surface_shape
    assert error(done.image, truth) < (0.75 if method != "rl-fast" else 0.95) * error(frame, truth)
    assert done.why
    assert (done.iterations > 0) == (done.method not in ("raw", "wiener", "idle"))


@pytest.mark.parametrize("method", ["wiener", "nnls", "tv", "auto"])
@pytest.mark.parametrize("refine", [2, 3])
def test_a_finer_surface_is_restored_too(covered, pressed, method, refine):
    blur = covered(refine=refine)
    frame, truth = pressed(blur, SIGMA)
    image = make(method, blur, SIGMA)(frame).image
    assert image.shape == (12 * refine, 12 * refine)
    assert error(image, truth) < 0.9 * error(np.kron(frame, np.ones((refine, refine))), truth)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("method", SHARP)
@pytest.mark.parametrize("sigma", [0.05, 0.5, 5.0])
def test_total_force_stays_within_the_noise(covered, pressed, method, layout, sigma):
    blur = covered((16, 16), layout=layout)
    for seed in range(5):
        frame, _ = pressed(blur, sigma, seed)
        image = make(method, blur, sigma)(frame).image
        predicted = float((blur.reach * image).sum())
        assert abs(predicted - frame.sum()) <= 4 * sigma * np.sqrt(frame.size)


@pytest.mark.parametrize("method", ["wiener", "nnls", "tv", "rl"])
@pytest.mark.parametrize("thickness", [0.5, 2.0])
def test_total_force_at_the_border_is_the_blurs_own(covered, method, thickness):
    """By the modes alone, which a blur does not quite keep apart, it was out by 16 deviations of the noise."""
    blur, random = covered((16, 16), thickness), np.random.default_rng(0)
    truth = np.zeros((16, 16))
    truth[:5, 9:] = 80
    frame = (blur.forward(truth) + random.normal(0, 0.05, truth.shape)).astype(np.float32)
    image = make(method, blur, 0.05)(frame).image
    assert abs(float((blur.reach * image).sum()) - frame.sum()) <= 0.05 * np.sqrt(frame.size)


def test_images_of_least_squares_lucy_and_auto_do_not_pull(covered, pressed):
    blur = covered()
    for method in ("rl", "rl-fast", "nnls", "tv"):
        assert make(method, blur, SIGMA)(pressed(blur, SIGMA)[0]).image.min() >= 0


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("method", ["wiener", "rl", "nnls", "tv", "auto"])
@pytest.mark.parametrize("flag", [MISSING, BAD, DEAD])
def test_unknown_taxels_are_inferred_whatever_they_say(covered, pressed, method, flag, layout):
    blur = covered((16, 16), layout=layout)
    frame, truth = pressed(blur, SIGMA)
    whole = error(make(method, blur, SIGMA)(frame).image, truth)
    gone = np.random.default_rng(1).random(frame.shape) < 0.05
    gone |= (frame >= np.sort(frame, axis=None)[-30]) & (np.arange(frame.size).reshape(frame.shape) % 7 == 0)
    flags = np.where(gone, flag, 0).astype(np.uint8)
    broken = [np.where(gone, value, frame).astype(np.float32) for value in (0.0, 1e4, np.nan, -np.inf)]
    images = [make(method, blur, SIGMA)(each, flags).image.copy() for each in broken]
    for image in images:
        np.testing.assert_array_equal(image, images[0])
    assert error(images[0], truth) < whole + 0.15
    assert error(make(method, blur, SIGMA)(broken[0]).image, truth) > error(images[0], truth)


def test_not_finite_is_unknown_without_a_flag(covered, pressed):
    blur = covered()
    frame, _ = pressed(blur, SIGMA)
    flags = np.zeros(frame.shape, np.uint8)
    flags[4, 4] = DEAD
    expected = make("nnls", blur, SIGMA)(frame, flags).image.copy()
    frame[4, 4] = np.nan
    np.testing.assert_array_equal(make("nnls", blur, SIGMA)(frame).image, expected)


def test_a_saturated_taxel_is_a_lower_bound(covered):
    blur = covered((16, 16))
    y, x = np.mgrid[:16, :16] - 7.3
    truth = 100 * np.exp(-(x**2 + y**2) / 8)
    frame = (blur.forward(truth) + np.random.default_rng(0).normal(0, SIGMA, (16, 16))).astype(np.float32)
    ceiling = np.float32(0.7 * frame.max())
    flags = np.where(frame >= ceiling, SATURATED, 0).astype(np.uint8)
    cut = np.minimum(frame, ceiling)
    naive = error(make("nnls", blur, SIGMA)(cut).image, truth)
    assert error(make("nnls", blur, SIGMA)(cut, flags).image, truth) < 0.7 * naive


def test_frames_and_images_of_the_caller_are_not_touched(covered, pressed):
    blur = covered()
    for method in METHODS:
        frame, _ = pressed(blur, SIGMA)
        frame[0, 0] = np.nan
        before = frame.copy()
        make(method, blur, SIGMA)(frame)
        np.testing.assert_array_equal(frame, before)


def test_the_same_frames_after_a_reset_give_the_same_images(covered, pressed):
    blur = covered()
    frames = [pressed(blur, SIGMA, seed)[0] for seed in range(4)]
    for method in METHODS:
        restorer = make(method, blur, SIGMA)
        first = [restorer(frame).image.copy() for frame in frames]
        restorer.reset()
        for frame, image in zip(frames, first, strict=True):
            np.testing.assert_array_equal(restorer(frame).image, image)


def test_warm_iterations_are_fewer_and_no_worse(covered, pressed):
    blur = covered((24, 24))
    restorer = make("nnls", blur, SIGMA)
    cold = restorer(pressed(blur, SIGMA, 0)[0]).iterations
    for seed in range(1, 6):
        frame, truth = pressed(blur, SIGMA, seed)
        warm = restorer(frame)
    fresh = make("nnls", blur, SIGMA)(frame)
    assert warm.iterations < cold / 2
    assert error(warm.image, truth) < 1.05 * error(fresh.image, truth)


@pytest.mark.parametrize(("method", "most"), [("nnls", 1.4), ("tv", 1.7), ("auto", 1.4)])
@pytest.mark.parametrize("thickness", [1.0, 2.0])
def test_a_moving_press_is_hardly_the_worse_for_the_image_before(monkeypatch, method, most, thickness):
    """Discs and Braille move by 0.4 pitches a frame; the image before as it was made up to six times the error."""
    monkeypatch.setattr("tactiled.study.skin.STEP", 0.4)
    skin = rubber(thickness, 24)
    for scene in ("punches", "braille"):
        clip = next(clips(skin, 0.002, 5, 7, (scene,)))
        following = make(method, skin.blur, clip.sigma)
        for frame, truth in zip(clip.frames, clip.truths, strict=True):
            image, fresh = following(frame).image, make(method, skin.blur, clip.sigma)(frame).image
            assert error(image, truth) < most * error(fresh, truth)


@pytest.mark.parametrize("method", ["nnls", "tv", "points", "auto"])
def test_a_frame_that_has_nothing_to_do_with_the_one_before_is_restored_as_the_first(method):
    for thickness in (0.5, 2.0):
        found = list(presses(16, (thickness,), (0.01,), seed=11))
        following = make(method, found[0].blur, 1.0)
        for press in found:
            frame = (press.frame / press.sigma).astype(np.float32)
            done, fresh = following(frame), make(method, press.blur, 1.0)(frame)
            assert (done.method, done.iterations) == (fresh.method, fresh.iterations)
            np.testing.assert_array_equal(done.image, fresh.image)


def test_noise_gain_is_what_noise_becomes(covered, pressed):
    blur = covered((16, 16))
    frame, truth = pressed(blur, SIGMA)
    clean = blur.forward(truth).astype(np.float32)
    restorer = make("wiener", blur, SIGMA)
    told = restorer(frame).noise_gain
    random = np.random.default_rng(2)
    images = []
    for _ in range(200):
        images.append(restorer(clean + random.normal(0, SIGMA, clean.shape).astype(np.float32)).image.copy())
    assert np.std(images, axis=0).mean() / SIGMA == pytest.approx(told, rel=0.15)


def test_resolution_is_finer_with_less_noise_and_never_beyond_the_cells(covered, pressed):
    blur = covered((24, 24))
    frame, _ = pressed(blur, 0.01)
    told = [make("wiener", blur, sigma)(frame).resolution_mm for sigma in (0.01, 0.1, 1.0, 10.0)]
    assert told == sorted(told)
    assert told[0] >= blur.cell_mm / np.sqrt(2)
    assert told[-1] > 1.5 * told[0]


def test_resolution_of_nothing_is_the_whole_array(covered):
    blur = covered()
    for method in METHODS:
        assert make(method, blur, SIGMA)(np.zeros((12, 12), np.float32)).resolution_mm == 12


@pytest.mark.parametrize("layout", LAYOUTS)
def test_deviation_holds_the_error(covered, pressed, layout):
    blur = covered((16, 16), layout=layout)
    frame, truth = pressed(blur, SIGMA)
    restorer = make("wiener", blur, SIGMA)
    image, spread = restorer(frame).image, restorer.deviation()
    assert spread.shape == blur.surface_shape
    assert np.isfinite(spread).all()
    assert (spread > 0).all()
    assert 0.3 < np.sqrt(np.mean((image - truth) ** 2) / np.mean(spread**2)) < 3


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan, np.inf])
def test_a_noise_that_is_none_is_refused(covered, noise):
    with pytest.raises(ConfigError, match=r"noise = .*: give a taxel's standard deviation"):
        make("auto", covered(), noise)


def test_a_method_that_is_none_is_refused(covered):
    with pytest.raises(ConfigError, match="method = 'sharpen': no such method: choose one of auto"):
        make("sharpen", covered(), SIGMA)
