import numpy as np
import pytest

from tactiled.restore.noise import are_multiples, estimate, estimate_with_rounding, noise_ratio


def press(frames, sigma, peak=100.0):
    """Frames of a press that moves evenly, with noise."""
    y, x = np.mgrid[:20, :20]
    middle = 6 + 8 * np.arange(frames)[:, None, None] / max(frames, 60)
    clean = peak * np.exp(-((x - middle) ** 2 + (y - 10) ** 2) / 18)
    return clean + np.random.default_rng(0).normal(0, sigma, clean.shape)


@pytest.mark.parametrize("sigma", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("frames", [3, 10, 100])
def test_noise_under_a_moving_press(frames, sigma):
    assert estimate(press(frames, sigma)) == pytest.approx(sigma, rel=0.12)


@pytest.mark.parametrize("sigma", [0.6, 0.7, 0.8, 1.5, 2.1])
def test_noise_of_whole_counts_is_no_whole_number_of_steps(sigma):
    """It came in steps of .605 counts: 30 % below the true one at .8, so that noise was a contact."""
    counts = np.round(80 + np.random.default_rng(1).normal(0, sigma, (32, 10, 16)))
    pressure = (0.05 * counts).astype(np.float32) - np.float32(3.987)
    assert estimate(pressure) == pytest.approx(0.05 * np.hypot(sigma, 12**-0.5), rel=0.05)


def test_only_rounded_readings_have_the_noise_of_rounding():
    floats = np.random.default_rng(2).normal(0, 0.02, (32, 8, 6)).astype(np.float32)
    floats[0, 0, 0] = np.nan
    assert estimate_with_rounding(floats, 12**-0.5, rounds=False) == pytest.approx(0.02, rel=0.1)
    whole = np.round(3 * floats / 0.02) + 0.3  # over a zero that is no whole count
    assert not are_multiples(np.diff(floats, axis=0), 1.0)
    assert are_multiples(np.diff(whole, axis=0), 1.0)
    for still, rounds in ((0 * whole, False), (0 * floats, True)):
        assert estimate_with_rounding(still, 12**-0.5, rounds) == 12**-0.5


@pytest.mark.parametrize("frames", [1, 2])
def test_one_frame_has_to_do(frames):
    assert estimate(press(frames, 2.0)) == pytest.approx(2.0, rel=0.5)


@pytest.mark.parametrize("every", [2, 3])
def test_noise_of_a_skin_that_is_slower_than_its_frames(every):
    """Every second or third frame missing left no second difference: the noise was 1e-4 of the peak."""
    frames = press(60, 1.0)
    if every == 2:
        frames[::2, :, :5] = np.nan  # one board's taxels are a frame late
        frames[1::2, :, 5:] = np.nan
    else:
        frames[::3] = np.nan
    assert estimate(frames) == pytest.approx(1.0, rel=0.12)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30, -1e300])
def test_unknown_and_implausible_values_do_not_count(value):
    """One value of 1e30 made a noise of 1e26 kPa of a short recording."""
    frames = press(20, 1.0)
    frames[:, 3] = frames[5:7, 7, 7] = frames[6, 7, 8] = value
    assert estimate(frames) == pytest.approx(1.0, rel=0.12)


def test_a_row_of_wild_taxels_does_not_count():
    frames = press(20, 1.0)
    frames[:, :1] = np.random.default_rng(1).normal(0, 1000, frames[:, :1].shape)
    assert estimate(frames) == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 5), (4, 7), (1, 2), (5, 20, 20)])
def test_frames_without_noise_still_have_some(shape):
    assert estimate(np.ones(shape)) == pytest.approx(1e-4)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_frames_without_pressure_have_none(value):
    assert estimate(np.full((4, 3, 3), value)) == 0


@pytest.mark.parametrize("sigma", [0.2, 1.0, 5.0])
def test_unrelated_presses_are_no_noise(sigma):
    random = np.random.default_rng(3)
    y, x = np.mgrid[:20, :20]
    places = random.uniform(2, 18, (30, 2))
    clean = [100 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 18) for a, b in places]
    assert estimate(clean + random.normal(0, sigma, (30, 20, 20))) == pytest.approx(sigma, rel=0.12)


@pytest.mark.parametrize("peak", [0.0, 100.0])
def test_noise_that_taxels_share_counts_on_an_idle_and_on_a_pressed_pad(peak):
    shared = np.random.default_rng(4).normal(0, 2.0, (200, 1, 1))
    assert estimate(np.repeat(press(1, 0.0, peak), 200, axis=0) + shared) == pytest.approx(2.0, rel=0.12)


def test_only_clearly_noisy_taxels_have_a_ratio_and_it_stays_while_it_holds():
    noise = np.array([1.0, 1.1, 0.9, 1.9, 3.0, np.nan])
    ratio = noise_ratio(noise, 0.5)
    np.testing.assert_allclose(ratio, [1, 1, 1, 1, 3.0 / 1.1, 1])  # to the median, which is higher
    assert noise_ratio(noise, 2.0, ratio) is None
    assert noise_ratio(noise * np.nan, 0.5) is None
    assert noise_ratio(0.87 * noise, 0.957, ratio) is ratio
    noise[4] = 1.5
    assert noise_ratio(noise, 0.5, ratio) is None
