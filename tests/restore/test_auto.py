import re

import numpy as np
import pytest

from tactiled.bench.skin import nrmse, rubber, sense
from tactiled.frames import DEAD
from tactiled.restore.auto import WORTH
from tactiled.restore.methods import METHODS, make
from tests.bench.presses import presses

SIGMA = 0.5
SHAPE = (24, 24)
POINT = np.eye(24) * (np.arange(24) == 12) * 40.0


def bump(width, peak=60.0):
    y, x = np.mgrid[:24, :24] - 11.7
    return peak * np.exp(-(x**2 + y**2) / (2 * width**2))


def test_noise_alone_is_idle_and_its_image_zero(covered, sensed):
    auto = make("auto", covered(SHAPE), SIGMA)
    results = [auto(sensed(np.zeros(SHAPE))) for _ in range(200)]
    idle = [done for done in results if done.method == "idle"]
    assert len(idle) >= 198
    assert not any(done.image.any() or done.iterations for done in idle)


@pytest.mark.parametrize(
    "truth",
    [POINT, -POINT, np.full(SHAPE, 0.2), np.full(SHAPE, -0.2)],
    ids=["a point", "a taxel that fell", "a faint uniform load", "a faint uniform drift"],
)
def test_what_stands_out_in_one_taxel_or_in_the_sum_is_not_idle(covered, sensed, truth):
    assert make("auto", covered(SHAPE), SIGMA)(sensed(truth)).method != "idle"


def test_raw_where_the_cover_hardly_matters(covered, sensed):
    frame = sensed(bump(5, 80), 0.05)
    done = make("auto", covered(SHAPE, 0.05), SIGMA)(frame)
    assert done.method == "raw"
    np.testing.assert_array_equal(done.image, frame)
    assert make("auto", covered(SHAPE, 0.05), SIGMA)(sensed(bump(1, 10), 0.05)).method != "raw"


@pytest.mark.parametrize("name", [name for name in METHODS if name != "raw"])
def test_no_spectrum_is_new_to_a_small_array(covered, sensed, monkeypatch, name):
    """A frame that was the first to show one took three times as long."""
    restorer = make(name, covered(SHAPE), SIGMA)
    restorer.prepare()
    monkeypatch.delattr("tactiled.restore.wiener.Filter.__init__")
    monkeypatch.delattr("tactiled.restore.nonnegative.Smooth.__init__")
    methods = {restorer(sensed(truth)).method for truth in (20 + bump(5), bump(1), bump(2, 5))}
    assert methods == {"auto": {"wiener", "learned"}, "points": {"nnls"}}.get(name, {name})


def test_no_spectrum_is_new_to_64_taxels_a_side(covered, monkeypatch):
    restorer = make("auto", covered((64, 64)), SIGMA)
    restorer.prepare()
    monkeypatch.delattr("tactiled.restore.wiener.Filter.__init__")
    distance = np.hypot(*np.indices((64, 64)) - 31.5)
    for width in (2, 8, 24):
        assert restorer(np.asarray(100 * np.exp(-((distance / width) ** 2)), np.float32)).method != "idle"


def test_what_was_prepared_shows_nowhere(covered):
    fresh, prepared = (make("auto", covered(SHAPE), SIGMA) for _ in range(2))
    prepared.prepare()
    np.testing.assert_array_equal(prepared.deviation(), fresh.deviation())


def test_no_fit_begins_without_time(two_indenters):
    press, alone = two_indenters
    auto, methods = make("auto", press.blur, press.sigma), []
    for time in (1, 2):  # checks until it is over: of the network, of the fit
        checks = iter([False] * time)
        done = auto(press.frame, expired=lambda checks=checks: next(checks, True))
        methods.append((done.method, done.cut_short))
    assert methods == [("learned", True), (alone.method, False)] == [("learned", True), ("points", False)]


def test_every_choice_has_a_reason(covered, sensed):
    auto = make("auto", covered(SHAPE), SIGMA)
    results = [auto(sensed(truth)) for truth in (0 * bump(1), 20 + bump(5), bump(1))]
    assert [done.method for done in results] == ["idle", "wiener", "learned"]
    assert results[0].why == "no contact above the noise"
    for done, smooth in zip(results[1:], (True, False), strict=True):
        share = float(re.search(r"([\d.]+)% of the Wiener-filtered image is below zero", done.why)[1]) / 100
        assert (share < WORTH) == smooth


def test_a_dead_taxel_keeps_no_pad_from_being_idle(covered, sensed):
    auto = make("auto", covered(SHAPE), SIGMA)
    flags = np.zeros(SHAPE, np.uint8)
    flags[3, 4] = DEAD
    frame = sensed(np.zeros(SHAPE))
    frame[3, 4] = 500
    assert auto(frame, flags).method == "idle"


@pytest.mark.parametrize("thickness", [1.0, 3.0])
@pytest.mark.parametrize("past", [-0.5, 0.5])
def test_a_contact_over_the_edge_is_nearer_to_the_truth_than_raw(thickness, past):
    """A model that ends with the taxels drew all of it on the last row: up to five times as far as raw."""
    larger, skin = rubber(thickness, 40), rubber(thickness, 24)
    distance = np.hypot(larger.surface.x - 12 - past, larger.surface.y - 1.3)
    fine = np.where(distance < 3, 100.0, 0.0)
    (frame, truth), part = sense(larger, fine), (slice(8, -8), slice(8, -8))
    sigma = 0.01 * frame.max()
    frame = (frame[part] + np.random.default_rng(1).normal(0, sigma, (24, 24))).astype(np.float32)
    done = make("auto", skin.blur, sigma)(frame)
    assert done.method == "learned"
    assert nrmse(done.image, truth[part]) < 0.6 * nrmse(frame, truth[part])


def test_discs_in_strong_noise_are_nearer_to_the_truth_than_raw_in_the_mean():
    """Of 1.5 to 3.5 pitches, under a cover of three, in 10 % noise: the smallest may be drawn as a spike."""
    ratios = []
    for press in (each for each in presses(24, (2.5, 3.0), (0.1,), 5, seed=9002) if each.scene == "punches"):
        image = make("auto", press.blur, press.sigma)(press.frame).image
        ratios.append(nrmse(image, press.truth) / nrmse(press.frame, press.truth))
    assert np.mean(ratios) < 0.75
    assert sum(each > 1.02 for each in ratios) <= 2


@pytest.fixture
def two_indenters():
    press = next(each for each in presses(24, (1.0,), (0.002,), 6, seed=2) if each.scene == "points")
    return press, make("points", press.blur, press.sigma)(press.frame)


def test_a_fit_does_not_depend_on_the_loads_before(two_indenters):
    press, _ = two_indenters
    auto = make("auto", press.blur, press.sigma)
    image = auto(press.frame).image.copy()
    assert auto(np.roll(press.frame, 1, axis=0)).method == "points"
    np.testing.assert_array_equal(auto(press.frame).image, image)


def test_an_image_that_was_cut_short_is_the_best_so_far(covered, sensed):
    truth = np.zeros(SHAPE)
    truth[10:13, 10:13] = 100
    frame, auto = sensed(truth, 2.0), make("auto", covered(SHAPE, 2.0), SIGMA)
    errors = {}
    for n in (0, 100):  # times that there is time left
        checks = iter([False] * n)
        done = auto(frame, expired=lambda checks=checks: next(checks, True))
        errors[n] = nrmse(done.image, truth), done.iterations, done.cut_short
    assert [each[1:] for each in errors.values()] == [(0, True), (3, False)]
    assert errors[0][0] > errors[100][0]


def test_where_no_load_is_fitted_no_time_for_it_is_missed(covered, sensed):
    truth = np.zeros(SHAPE)
    truth[8:16, 8:16] = 100
    checks = iter([False])  # of the network
    done = make("auto", covered(SHAPE, 2.0), SIGMA)(sensed(truth, 2.0), expired=lambda: next(checks, True))
    assert (done.method, done.iterations, done.cut_short) == ("learned", 3, False)
