import re

import numpy as np
import pytest

from tactiled.build import sensor_plans
from tactiled.calibrate.counts.tare import below_zero, blocks, load_description, robust_mean
from tactiled.config import parse
from tests.conftest import CONFIG

NOISE = 0.5  # kPa
FRAMES = 16
OFFSETS = (0.0, 30.0, -300.0)  # kPa, of the whole array


@pytest.fixture(scope="module", params=["8 x 8", "32 x 32"])
def blur(request):
    rows, columns = request.param.split(" x ")
    text = CONFIG.format(channel="tare").replace("rows = 8, columns = 8", f"rows = {rows}, columns = {columns}")
    (plan,) = sensor_plans(parse(text))
    return plan.blur


@pytest.fixture
def observe(blur):
    """Describe the load in noisy frames of a still load (kPa on the surface), or of one each, over an offset."""
    random = np.random.default_rng(7)

    def observe(load=0.0, offset=0.0, frames=FRAMES):
        loads = [load(n) if callable(load) else load for n in range(frames)]
        felt = [blur.forward(np.full(blur.surface_shape, 1.0, np.float32) * each) for each in loads]
        return load_description(
            [each + offset + random.normal(0, NOISE, blur.frame_shape).astype(np.float32) for each in felt], NOISE
        )

    return observe


@pytest.fixture
def disc(blur):
    """A flat press of some kPa, its middle and radius in parts of the array."""
    y, x = ((np.arange(n) + 0.5) / n for n in blur.surface_shape)

    def disc(kpa, radius, middle=(0.4, 0.6)):
        return kpa * (np.hypot(y[:, None] - middle[0], x - middle[1]) < radius)

    return disc


@pytest.mark.parametrize("frames", [0, 1, FRAMES])
@pytest.mark.parametrize("offset", OFFSETS)
def test_an_offset_of_the_whole_array_is_no_load(observe, offset, frames):
    for _ in range(20):
        assert observe(offset=offset, frames=frames) == ""


@pytest.mark.parametrize("common", [0.0, 1.0, 2.0, 20.0, -20.0])
@pytest.mark.parametrize("scatter", [1.0, 2.0, 10.0, 100.0])
def test_an_array_that_drifted_or_was_never_tared_shows_no_load(blur, observe, common, scatter):
    """Every taxel has its own offset; kPa."""
    random = np.random.default_rng(1)
    for _ in range(20):
        assert observe(offset=common + random.uniform(-scatter, scatter, blur.frame_shape)) == ""


def test_offsets_of_which_a_tenth_read_zero_by_chance_rarely_pass_for_a_load(blur, observe):
    """Others read less than zero, which none does under a load."""
    random = np.random.default_rng(3)
    descriptions = [observe(offset=random.normal(100, 100, blur.frame_shape)) for _ in range(40)]
    assert sum(map(bool, descriptions)) <= 2


def test_a_tilt_and_a_tare_under_load_are_no_load(blur, observe, disc):
    for common in OFFSETS:
        assert observe(offset=common + np.linspace(-20, 20, blur.frame_shape[1])) == ""
    assert observe(offset=-blur.forward(disc(50.0, 0.3).astype(np.float32))) == ""


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize(("kpa", "radius"), [(20.0, 0.1), (20.0, 0.3), (200.0, 0.1), (200.0, 0.3)])
def test_a_press_is_a_load_over_any_offset(observe, disc, kpa, radius, offset):
    assert observe(disc(kpa, radius), offset).startswith("contact of ")


def test_a_press_is_a_load_among_offsets_of_the_taxels_and_on_most_of_a_tared_array(blur, observe, disc):
    offset = np.random.default_rng(2).normal(10, 3, blur.frame_shape)
    assert observe(disc(200.0, 0.1), offset).startswith("contact of ")
    load = disc(50.0, 0.45, (0.5, 0.4))
    assert np.mean(load > 0) > 0.55
    assert observe(load).startswith("contact of ")


@pytest.mark.parametrize("offset", OFFSETS)
def test_readings_that_move_on_the_whole_array_are_a_load(observe, offset):
    assert observe(lambda n: 10.0 + 0.5 * n, offset).startswith("readings that move by ")


def test_a_load_is_described_in_kpa_and_taxels():
    frame = np.zeros((4, 4), np.float32)
    assert load_description([frame], NOISE) == ""
    frame[1, 1] = 12
    assert load_description([frame], NOISE) == "contact of 12.0 kPa on taxel 5"
    frame[:2, :2] = 12, 9
    assert load_description([frame], NOISE) == "contact of 12.0 kPa on 4 taxels"
    assert load_description([frame], NOISE, "counts") == "contact of 12.0 counts on 4 taxels"
    assert load_description([frame * 200], NOISE, "counts") == "contact of 2400 counts on 4 taxels"
    assert load_description([frame * 0, frame * 0 + 8], NOISE) == "readings that move by 4.00 kPa"


def test_an_unknown_taxel_is_left_out():
    frame = np.zeros((4, 4), np.float32)
    frame[0, 0] = np.nan
    once = frame.copy()
    once[1, 1] = np.nan
    assert load_description([frame, once], NOISE) == ""
    assert load_description([np.full((4, 4), np.nan, np.float32)], NOISE) == ""
    frame[2, 2] = 50
    assert load_description([frame, once], NOISE) == "contact of 25.0 kPa on taxel 10"


@pytest.mark.parametrize("times", [10, 30])
def test_a_noisy_taxel_is_no_load_and_what_lies_on_it_or_beside_it_is(times):
    random = np.random.default_rng(4)
    for _ in range(100):
        frames = random.normal(0, NOISE, (FRAMES, 256)).astype(np.float32)
        frames[:, 37] *= times
        assert load_description(frames, NOISE) == ""
        frames[:, 37] += 20 * times * NOISE
        assert re.fullmatch(r"contact of \S+ kPa on taxel 37", load_description(frames, NOISE))
        frames[:, 90:92] += 30 * times * NOISE
        assert load_description(frames, NOISE).endswith("on 3 taxels")


def test_a_load_that_shakes_several_taxels_is_no_noise():
    frames = np.random.default_rng(4).normal(0, NOISE, (FRAMES, 256)).astype(np.float32)
    frames[:, 40:46] *= 20
    assert load_description(frames, NOISE)


def zero_errors(estimate, noise, spikes, frames=50, taxels=20_000):
    """Root mean square error of a zero (counts), of rounded counts with spikes of 300 counts."""
    random = np.random.default_rng(5)
    true = random.uniform(100, 101, taxels)
    counts = np.round(true + random.normal(0, noise, (frames, taxels)))
    counts[random.random(counts.shape) < spikes] += 300
    return float(np.sqrt(np.mean((estimate(counts) - true) ** 2)))


@pytest.mark.parametrize("noise", [0.1, 0.3, 1.5, 5.0])
def test_the_zero_is_as_good_as_a_mean_and_spikes_leave_it_alone(noise):
    best = zero_errors(lambda counts: counts.mean(0), noise, spikes=0)
    for spikes in (0, 0.02, 0.1):
        assert zero_errors(robust_mean, noise, spikes) < 1.03 * best / np.sqrt(1 - spikes)  # of fewer frames
        assert zero_errors(lambda counts: np.median(counts, 0), noise, spikes) > 1.25 * best
    middle = zero_errors(lambda counts: np.sort(counts, 0)[5:-5].mean(0), 0.3, 0.02)
    assert middle > 2.5 * zero_errors(robust_mean, 0.3, 0.02)


def test_unknown_counts_are_left_out_of_a_zero():
    counts = np.array([[1.0, np.nan, np.nan], [2.0, 5.0, np.nan], [3.0, 7.5, np.nan]], np.float32)
    np.testing.assert_array_equal(robust_mean(counts), [2, 6.25, np.nan])
    assert [each[0] for each in blocks(np.arange(8.0)[:, None])] == [0.5, 2.5, 4.5, 6.5]


@pytest.mark.parametrize("kind", ["noise", "offset", "undershoot", "slopes"])
def test_what_is_no_load_under_a_tare_is_not_far_below_zero(kind):
    random = np.random.default_rng(8)
    for _ in range(50):
        pressure = random.normal(0, 0.4, (16, 16))
        pressure[random.random((16, 16)) < 0.1] = np.nan
        if kind == "offset":
            pressure -= 30
            pressure[3:6, 3:6] += 200
        elif kind == "undershoot":
            pressure[3:6, 3:6] -= 8  # of a skin that felt 100
        elif kind == "slopes":
            pressure -= random.uniform(1, 4) * np.linspace(0, 1, 16)
        assert not below_zero(pressure.astype(np.float32), 0.4, 100.0 * (kind == "undershoot")).any()


def test_what_a_load_under_a_tare_leaves_is_far_below_zero():
    pressure = np.random.default_rng(9).normal(-5, 0.4, (16, 16))
    pressure[4:10, 4:10] -= 20
    pressure[10, 4:10] -= 4  # its skirt
    below = below_zero(pressure.astype(np.float32), 0.4, 80.0)
    assert below[4:11, 4:10].all()
    assert np.count_nonzero(below) < 42 + 12
    most = np.random.default_rng(9).normal(0, 0.4, (16, 16))
    most[:, 5:] -= 20 * np.sin(np.linspace(0, np.pi, 11)) * np.sin(np.linspace(0, np.pi, 16))[:, None]
    below = below_zero(most.astype(np.float32), 0.4, 0.0)
    assert below[4:12, 7:14].all()
    assert not below[:, :5].any()
    most[:, 5:] = np.where(np.abs(most[:, 5:]) > 1, -50 * np.random.default_rng(9).random((16, 11)), most[:, 5:])
    below = below_zero(
        most.astype(np.float32), 0.4, 0.0
    )  # under a rough thing that left a third of the taxels free
    np.testing.assert_array_equal(below, most < most[below].max() + 1e-6)
    assert most[below].max() > -4
    tip = np.random.default_rng(9).normal(0, 0.4, (16, 16))
    tip[4:10, 4:10] -= 15
    tip[:, 2:14] += 30 * np.random.default_rng(9).random(
        (16, 12)
    )  # what is pressed after a tare under a fingertip
    assert below_zero(tip.astype(np.float32), 0.4, 30.0)[tip < -6].all()
    for reading in (np.nan, -50.0):  # of all taxels
        assert not below_zero(np.full((16, 16), reading, np.float32), 0.4, 0.0).any()
