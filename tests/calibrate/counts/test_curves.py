import numpy as np
import pytest

from tactiled.calibrate.counts.curves import Curves
from tactiled.errors import ConfigError

KNOTS = [0.2, 0.5, 1.0]
SHAPES = {
    "linear": [[0.05], [0.08]],
    "power": [[50.0, 1.3], [80.0, 0.7]],
    "cubic": [[40.0, -30.0, 40.0], [50.0, 20.0, 10.0]],
    "spline": [[5.0, 20.0, 50.0], [30.0, 60.0, 80.0]],
}


def curves(form, reach=((0, 1000), (0, 1000)), **changed):
    size = len(SHAPES[form])
    fields = {
        "parameters": SHAPES[form],
        "reach_counts": reach,
        "deviation": np.full(size, 0.01),
        "hysteresis": np.full(size, np.nan),
        "individual": np.ones(size, bool),
        "knots": KNOTS if form == "spline" else [],
    }
    return Curves(form, **(fields | changed))


@pytest.mark.parametrize("form", SHAPES)
def test_a_curve_rises_through_zero_and_its_inverse_and_slope_belong_to_it(form):
    one = curves(form)
    counts = np.linspace(-300, 1500, 901)[:, None] * np.ones(2)
    pressure = one.pressure(counts)
    assert (np.diff(pressure, axis=0) > 0).all()
    np.testing.assert_allclose(one.pressure(np.zeros(2)), 0, atol=1e-12)
    np.testing.assert_allclose(one.pressure(np.full(2, 1000.0)), [50, 80], rtol=1e-12)
    np.testing.assert_allclose(one.counts(pressure), counts, atol=1e-6)
    inner = slice(1, -1)
    smooth = np.abs(counts[inner, :1] - [0, 10, 1000]).min(axis=1) > 5
    numeric = (one.pressure(counts + 1e-3) - one.pressure(counts - 1e-3)) / 2e-3
    np.testing.assert_allclose(one.slope(counts)[inner][smooth], numeric[inner][smooth], rtol=1e-4)
    assert one.out_of_range(np.array([1001.0, 999.0])).tolist() == [True, False]
    assert np.isnan(one.pressure(np.array([np.nan, 5.0]))).tolist() == [True, False]


@pytest.mark.parametrize("form", SHAPES)
def test_counts_that_fall_under_pressure_mirror_those_that_rise(form):
    rising = curves(form)
    changed = {"parameters": -np.array(SHAPES[form])} if form == "linear" else {}
    falling = curves(form, reach=[(-1000, 0), (-1000, 0)], **changed)
    counts = np.linspace(-300, 1500, 61)[:, None] * np.ones(2)
    np.testing.assert_allclose(falling.pressure(-counts), rising.pressure(counts))
    np.testing.assert_allclose(falling.counts(rising.pressure(counts)), -counts, atol=1e-6)
    assert (falling.slope(-counts) < 0).all()
    assert (falling.gain < 0).all()
    np.testing.assert_array_equal(falling.out_of_range(-counts), rising.out_of_range(counts))


def test_the_forms_are_the_textbook_ones():
    from scipy.interpolate import PchipInterpolator

    counts = np.array([250.0, 800.0])
    u = counts / 1000
    np.testing.assert_allclose(curves("linear").pressure(counts), [12.5, 64])
    np.testing.assert_allclose(curves("power").pressure(counts), [50 * 0.25**1.3, 80 * 0.8**0.7])
    expected = [40 * u[0] - 30 * u[0] ** 2 + 40 * u[0] ** 3, 50 * u[1] + 20 * u[1] ** 2 + 10 * u[1] ** 3]
    np.testing.assert_allclose(curves("cubic").pressure(counts), expected)
    expected = [PchipInterpolator([0, *KNOTS], [0, *row])(x) for row, x in zip(SHAPES["spline"], u, strict=True)]
    np.testing.assert_allclose(curves("spline").pressure(counts), expected)


@pytest.mark.parametrize(
    ("form", "changed", "message"),
    [
        ("linear", {"parameters": [[0.05], [-0.1]]}, "parameters of taxel 1 is [-0.1]: a linear curve must rise"),
        ("power", {"parameters": [[50, 1], [np.nan, 1]]}, "parameters of taxel 1 is [nan, 1.0]: give numbers"),
        (
            "cubic",
            {"parameters": [[40, -90, 60], [1, 0, 0]]},
            "parameters of taxel 0 is [40.0, -90.0, 60.0]: a cubic",
        ),
        ("spline", {"parameters": [[5, 20, 50], [30, 30, 80]]}, "parameters of taxel 1 is [30.0, 30.0, 80.0]"),
        ("spline", {"knots": [0.5, 0.2, 1.0]}, "knots are [0.5, 0.2, 1.0]: give rising relative counts"),
        ("linear", {"reach_counts": [[0, 5], [3, 5]]}, "reach_counts of taxel 1 is [3.0, 5.0]"),
        ("linear", {"deviation": [0.1, -0.2]}, "deviation of taxel 1 is -0.2"),
        ("linear", {"deviation": [0.1]}, "deviation has shape (1,): a linear curve of 2 taxels needs (2,)"),
        ("linear", {"hysteresis": [0.1, -1]}, "hysteresis of taxel 1 is -1.0"),
    ],
)
def test_what_is_no_curve_is_refused_by_name(form, changed, message):
    with pytest.raises(ConfigError) as error:
        curves(form, **changed)
    assert str(error.value).startswith(message)


def test_an_unknown_form_is_refused():
    with pytest.raises(ConfigError, match="form is 'quartic': choose one of linear, power, cubic, spline"):
        Curves("quartic", np.ones((1, 1)), np.array([[0, 1]]), np.zeros(1), np.zeros(1), np.ones(1, bool))
