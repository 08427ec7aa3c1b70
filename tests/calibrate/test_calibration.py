import numpy as np
import pytest

from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED

NAN = float("nan")
COUNTS = (100, 300, 4095, 50)
CLEAR = np.zeros(4, np.uint8)


@pytest.mark.parametrize(
    ("calibration", "counts", "flags", "kpa", "flagged"),
    [
        (Calibration(0.5, no_load=100), COUNTS, 0, (0, 100, 1997.5, -25), 0),
        # a negative gain: counts fall under pressure
        (Calibration(-1.0, 240, 60), (240, 100, 60, 12), 0, (0, 140, 180, 228), (0, 0, SATURATED, SATURATED)),
        (Calibration(1.0, saturation=4095), COUNTS, 0, COUNTS, (0, 0, SATURATED, 0)),
        (Calibration(), COUNTS, (0, MISSING, 0, BAD), (100, NAN, 4095, NAN), (0, MISSING, 0, BAD)),
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


def test_a_dead_taxel_that_the_array_does_not_have_is_refused():
    with pytest.raises(ConfigError, match="dead names taxel 4: the array has 0 to 3"):
        Calibrator(Calibration(dead=(4,)), 4)


def test_the_noise_floor_is_that_of_rounding():
    values = np.random.default_rng(1).uniform(0, 1000, 200_000)
    assert Calibration(-0.5).floor_kpa == pytest.approx(np.std((np.round(values) - values) * 0.5), rel=0.01)
