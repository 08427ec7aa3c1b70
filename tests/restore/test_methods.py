import numpy as np
import pytest

from tactiled.bench.skin import nrmse
from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED
from tactiled.restore.methods import METHODS, make, named
from tests.bench.presses import presses

SIGMA = 0.5
RESTORING = [name for name in METHODS if name != "raw"]
LAYOUTS = [pytest.param(False, id="grid"), pytest.param(True, id="layout")]


def test_a_method_of_an_earlier_release_is_the_one_that_took_its_place(covered, pressed):
    blur = covered()
    frame, _ = pressed(blur, SIGMA)
    old, new = (make(name, blur, SIGMA)(frame) for name in ("rl-fast", "rl"))
    np.testing.assert_array_equal(old.image, new.image)
    assert named("rl-fast") == old.method == "rl"


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("method", RESTORING)
def test_a_restored_image_is_nearer_the_truth_than_the_raw_one(covered, pressed, method, layout):
    blur = covered(layout=layout)
    frame, truth = pressed(blur, SIGMA)
    done = make(method, blur, SIGMA)(frame)
    assert done.image.shape == blur.surface_shape
    assert nrmse(done.image, truth) < 0.75 * nrmse(frame.ravel()[blur.taxel], truth)
    assert done.why
    assert (done.iterations > 0) == (done.method not in ("raw", "wiener", "idle"))
    assert method in ("wiener", "auto", "points") or done.image.min() >= 0


@pytest.mark.parametrize("method", ["wiener", "nnls", "tv", "auto"])
@pytest.mark.parametrize("refine", [2, 3])
def test_a_finer_surface_is_restored_too(covered, pressed, method, refine):
    blur = covered(refine=refine)
    frame, truth = pressed(blur, SIGMA)
    image = make(method, blur, SIGMA)(frame).image
    assert image.shape == (12 * refine, 12 * refine)
    most = 0.95 if (method, refine) == ("wiener", 3) else 0.9
    assert nrmse(image, truth) < most * nrmse(np.kron(frame, np.ones((refine, refine))), truth)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("method", RESTORING)
@pytest.mark.parametrize("sigma", [0.05, 5.0])
def test_total_force_stays_within_the_noise(covered, pressed, method, layout, sigma):
    blur = covered((16, 16), layout=layout)
    for seed in range(3):
        frame, _ = pressed(blur, sigma, seed)
        image = make(method, blur, sigma)(frame).image
        drawn = 0.004 * frame.sum() if layout else 0  # cells of a layout are no squares of the raster
        missed = abs(float((blur.reach * image).sum()) - frame.sum())
        assert missed <= 4 * sigma * np.sqrt(frame.size) + drawn


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


@pytest.fixture
def punched(covered):
    """The blur of a cover, the noisy frame of a punch under it, and the truth."""

    def make_frame(thickness, sigma):
        blur, truth = covered((24, 24), thickness), np.zeros((24, 24))
        truth[10:13, 10:13] = 100
        noise = np.random.default_rng(0).normal(0, sigma, truth.shape)
        return blur, (blur.forward(truth) + noise).astype(np.float32), truth

    return make_frame


def test_richardson_lucy_stops_at_the_noise(punched):
    blur, frame, _ = punched(1.0, 5.0)
    assert 1 <= make("rl", blur, 5.0)(frame).iterations <= 10


def test_non_negative_least_squares_puts_no_pressure_beside_a_punch(punched):
    blur, frame, truth = punched(2.0, 0.5)
    assert make("nnls", blur, 0.5)(frame).image[truth == 0].sum() < 0.01 * truth.sum()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("method", ["wiener", "rl", "nnls", "tv", "auto"])
def test_unknown_taxels_are_inferred_whatever_their_values(covered, pressed, method, layout):
    blur = covered((16, 16), layout=layout)
    frame, truth = pressed(blur, SIGMA)
    unknown = np.random.default_rng(1).random(frame.shape) < 0.05
    unknown |= (frame >= np.sort(frame, axis=None)[-30]) & (np.arange(frame.size).reshape(frame.shape) % 7 == 0)
    kinds = np.resize([MISSING, BAD, DEAD], frame.shape)
    flags = np.where(unknown, kinds, 0).astype(np.uint8)
    assert len(np.unique(flags)) == 4
    broken = [np.where(unknown, value, frame).astype(np.float32) for value in (0.0, 1e4, np.nan, -np.inf)]
    images = [make(method, blur, SIGMA)(each, flags).image.copy() for each in broken]
    images.append(make(method, blur, SIGMA)(broken[2]).image)  # NaN is unknown without a flag
    for image in images:
        np.testing.assert_array_equal(image, images[0])
    assert nrmse(images[0], truth) < nrmse(make(method, blur, SIGMA)(frame).image, truth) + 0.15
    assert nrmse(images[0], truth) < nrmse(make(method, blur, SIGMA)(broken[0]).image, truth)


@pytest.mark.parametrize("method", METHODS)
def test_a_frame_without_data_is_zero_and_says_so_instead_of_no_contact(covered, pressed, method):
    restorer = make(method, covered(), SIGMA)
    restorer(pressed(covered(), SIGMA)[0])
    done = restorer(np.full((12, 12), np.nan, np.float32))
    assert (done.why, done.image.any()) == ("no taxel has data, and nothing is known", False)
    assert np.isnan(restorer.deviation()).all()


def test_a_saturated_taxel_is_a_lower_bound(covered):
    blur = covered((16, 16))
    y, x = np.mgrid[:16, :16] - 7.3
    truth = 100 * np.exp(-(x**2 + y**2) / 8)
    frame = (blur.forward(truth) + np.random.default_rng(0).normal(0, SIGMA, (16, 16))).astype(np.float32)
    ceiling = np.float32(0.7 * frame.max())
    flags = np.where(frame >= ceiling, SATURATED, 0).astype(np.uint8)
    cut = np.minimum(frame, ceiling)
    naive = nrmse(make("nnls", blur, SIGMA)(cut).image, truth)
    assert nrmse(make("nnls", blur, SIGMA)(cut, flags).image, truth) < 0.7 * naive
    alone = np.zeros((16, 16), np.float32)
    alone[5, 5] = 200  # which its neighbours do not suggest
    image = make("raw", blur, SIGMA)(alone, np.where(alone > 0, SATURATED, 0).astype(np.uint8)).image
    assert 200 <= image[5, 5] < 205


@pytest.mark.parametrize("size", [16, 34], ids=["full grid", "with windows"])
@pytest.mark.parametrize("method", METHODS)
def test_no_frame_matters_to_the_next_and_frames_of_the_caller_are_not_touched(method, size):
    """Presses that overlap, a contact that grows, damage and an idle pad: the image is that of the frame alone."""
    cases = list(presses(size, (2.0,), (0.01,), seed=11))
    frames = [(press.frame / press.sigma).astype(np.float32) for press in cases]
    frames += [(share * frames[1]).astype(np.float32) for share in (0.01, 0.1, 0.3, 0.35)]
    frames += [np.zeros_like(frames[0]), frames[0] + frames[2], frames[0] - 30]
    for damage, frame in zip((np.nan, np.inf, 1e9, 1e30, 3e38), frames[:5], strict=True):
        frames.append(np.where(frame > 50, np.float32(damage), frame))
    before, images = [frame.copy() for frame in frames], {}
    order = np.random.default_rng(0).permutation(len(frames))
    for turn in (order, order[::-1], order[5:6], order[9:10]):  # the last two are alone
        restorer = make(method, cases[0].blur, 1.0)
        for n in turn:
            done = restorer(frames[n])
            same = images.setdefault(n, done._replace(image=done.image.copy()))
            assert done[1:] == same[1:]
            np.testing.assert_array_equal(done.image, same.image)
    np.testing.assert_array_equal(frames, before)


def test_resolution_is_finer_with_less_noise_and_never_beyond_the_cells(covered, pressed):
    blur = covered((24, 24))
    frame, _ = pressed(blur, 0.01)
    resolutions = [make("wiener", blur, sigma)(frame).resolution_mm for sigma in (0.01, 0.1, 1.0, 10.0)]
    assert resolutions == sorted(resolutions)
    assert resolutions[0] >= blur.cell_mm / np.sqrt(2)
    assert resolutions[-1] > 1.5 * resolutions[0]
    for method in METHODS:  # of no contact: the array's width
        assert make(method, blur, SIGMA)(np.zeros((24, 24), np.float32)).resolution_mm == 24


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan, np.inf])
def test_invalid_noise_is_refused(covered, noise):
    with pytest.raises(ConfigError, match=r"noise = .*: give a taxel's standard deviation"):
        make("auto", covered(), noise)


def test_an_unknown_method_is_refused(covered):
    with pytest.raises(ConfigError, match="method = 'sharpen': no such method: choose one of auto"):
        make("sharpen", covered(), SIGMA)
