import numpy as np
import pytest

from tactiled.calibrate.counts.curve_fit import Points, choose_form, fit, moderated


@pytest.mark.parametrize("exponent", [0.3, 0.8, 1.7, 4.0])
def test_a_power_law_of_any_exponent_is_found_to_1e_6(exponent):
    relative = np.linspace(0.05, 1, 12)
    order = np.arange(12)
    points = Points(relative[:, None, None] * 900, 35 * relative**exponent, np.zeros(12, np.int8), order, order)
    end = np.array([900.0])
    assert choose_form(points, end)[0] == "power"
    got = fit(points, end, "power")
    np.testing.assert_allclose(got.parameters, [[35, exponent]], rtol=1e-6)


def test_a_simpler_form_stays_unless_a_better_one_wins_clearly():
    rng = np.random.default_rng(41)
    load = np.linspace(5, 60, 8)
    order, forms = np.arange(8), []
    for _ in range(8):
        counts = (load * 10 + rng.normal(0, 6, 8))[:, None, None]
        points = Points(counts, load, np.zeros(8, np.int8), order, order)
        forms.append(choose_form(points, counts.max(axis=(0, 2)))[0])
    assert forms.count("linear") >= 4  # each of three other forms wins by chance once in six times


def test_variances_are_moderated_as_far_as_their_spread_is_chance():
    rng = np.random.default_rng(42)
    chance = rng.chisquare(4, 4000) / 4
    assert np.ptp(moderated(chance, 4)) < 0.3
    real = chance * rng.choice([0.1, 10], 4000)
    assert np.corrcoef(moderated(real, 4), real)[0, 1] > 0.99
    assert np.ptp(moderated(real, 4)) > 5
