import numpy as np
import pytest

from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.counts.curves import Curves
from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, FAULTY, MISSING, OUT_OF_RANGE, SATURATED
from tests.calibrate.files import gain_section

NAN = float("nan")
COUNTS = (100, 300, 4095, 50)
CLEAR = np.zeros(4, np.uint8)


@pytest.mark.parametrize(
    ("calibration", "counts", "flags", "kpa", "flagged"),
    [
        (Calibration(0.5, no_load=100), COUNTS, 0, (0, 100, 1997.5, -25), 0),
        # a negative gain: counts fall under pressure
        (Calibration(-1.0, 240, 60), (240, 100, 60, 12), 0, (0, 140, 180, 228), (0, 0, SATURATED, SATURATED)),
        (
            Calibration(-1.0, 240, 60),
            (0, 100, 60, 0),
            (MISSING, 0, 0, BAD),
            (NAN, 140, 180, NAN),
            (MISSING, 0, SATURATED, BAD),
        ),
        (Calibration(1.0, saturation=4095), COUNTS, 0, COUNTS, (0, 0, SATURATED, 0)),
        (Calibration(), COUNTS, (FAULTY, MISSING, 0, BAD), (NAN, NAN, 4095, NAN), (FAULTY, MISSING, 0, BAD)),
        (Calibration(dead=(0, 3)), COUNTS, 0, (NAN, 300, 4095, NAN), (DEAD, 0, 0, DEAD)),
    ],
)
def test_counts_become_kpa_and_what_is_wrong_with_a_taxel_is_flagged(calibration, counts, flags, kpa, flagged):
    before = CLEAR + np.uint8(flags)
    pressure, after = Calibrator(calibration, 4)(np.array(counts, np.uint16), before)
    np.testing.assert_array_equal(pressure, np.float32(kpa))
    np.testing.assert_array_equal(after, CLEAR + np.uint8(flagged))
    np.testing.assert_array_equal(before, CLEAR + np.uint8(flags))  # the caller's are not written to
    assert pressure.dtype == np.float32


GAINS = np.array([0.5, -0.5, 1.0, 2.0])
REACH = np.array([[0, 150], [-150, 0], [0, 150], [0, 150]])
LINES = gain_section(GAINS, REACH).curves
POWERS = Curves("power", np.tile([90.0, 1.5], (4, 1)), REACH, *np.zeros((2, 4)), np.ones(4))


def test_each_taxel_has_its_own_line_and_no_load_and_what_is_beyond_its_range_is_flagged():
    calibrator = Calibrator(Calibration(curves=LINES, no_loads=np.array([100.0, 200, 0, 10])), 4)
    pressure, flags = calibrator(np.array([200, 100, 151, 0], np.uint16), CLEAR)
    np.testing.assert_array_equal(pressure, np.float32([50, 50, 151, -20]))
    np.testing.assert_array_equal(flags, [0, 0, OUT_OF_RANGE, 0])


@pytest.mark.parametrize("curves", [LINES, POWERS])
def test_counts_are_those_of_the_pressure_and_saturation_has_the_direction_of_the_gain(curves):
    calibration = Calibration(curves=curves, no_loads=np.array([100.0, 300, 0, 10]), saturation=200)
    counts = calibration.counts(np.full(4, 30.0))
    pressure, _ = Calibrator(calibration, 4)(counts.astype(np.float32), CLEAR)
    np.testing.assert_allclose(pressure, 30, rtol=1e-5)
    _, flags = Calibrator(calibration, 4)(np.array([199, 200, 199, 200], np.uint16), CLEAR)
    np.testing.assert_array_equal(flags & SATURATED, [0, SATURATED, 0, SATURATED])


def test_the_noise_floor_of_curves_is_that_of_the_median_taxel():
    assert Calibration(curves=LINES).floor_kpa == pytest.approx(0.75 / 12**0.5)


def test_tare_moves_the_zero_of_known_taxels():
    calibrator = Calibrator(Calibration(2.0, no_load=10), 4)
    calibrator.tare(np.array([20.5, np.nan, 4000.0, 50.0]))
    pressure, _ = calibrator(np.array(COUNTS, np.uint16), CLEAR)
    np.testing.assert_array_equal(pressure, np.float32([159, 580, 190, 0]))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("kpa_per_count", 0.0),
        ("kpa_per_count", NAN),
        ("no_load", float("inf")),
        ("noise_kpa", -1.0),
        ("shear_n_per_count", 0.0),
        ("shear_n_per_count", float("inf")),
    ],
)
def test_an_impossible_calibration_is_refused(key, value):
    with pytest.raises(ConfigError, match=f"{key} is {value}"):
        Calibration(**{key: value})


def test_a_calibration_of_another_array_is_refused():
    with pytest.raises(ConfigError, match="gain has 4 taxels: the array has 5"):
        Calibrator(Calibration(curves=LINES), 5)
    with pytest.raises(ConfigError, match="dead names taxel 4: the array has 0 to 3"):
        Calibrator(Calibration(dead=(4,)), 4)


def test_the_noise_floor_is_that_of_rounding():
    values = np.random.default_rng(1).uniform(0, 1000, 200_000)
    assert Calibration(-0.5).floor_kpa == pytest.approx(np.std((np.round(values) - values) * 0.5), rel=0.01)
