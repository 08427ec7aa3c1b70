import numpy as np
import pytest

from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED

COUNTS = np.array([100, 300, 4095, 50], np.uint16)
CLEAR = np.zeros(4, np.uint8)


def test_counts_become_kpa_by_offset_and_gain():
    pressure, flags = Calibrator(Calibration(kpa_per_count=0.5, no_load=100), 4)(COUNTS, CLEAR)
    np.testing.assert_array_equal(pressure, np.float32([0, 100, 1997.5, -25]))
    assert pressure.dtype == np.float32
    assert not flags.any()


def test_a_negative_gain_means_that_counts_fall_under_pressure():
    pressure, flags = Calibrator(Calibration(-1.0, no_load=240, saturation=60), 4)(
        np.array([240, 100, 60, 12], np.uint16), CLEAR
    )
    np.testing.assert_array_equal(pressure, np.float32([0, 140, 180, 228]))
    np.testing.assert_array_equal(flags, [0, 0, SATURATED, SATURATED])


def test_a_saturated_taxel_keeps_its_value_and_is_flagged():
    pressure, flags = Calibrator(Calibration(1.0, saturation=4095), 4)(COUNTS, CLEAR)
    np.testing.assert_array_equal(flags, [0, 0, SATURATED, 0])
    assert pressure[2] == 4095


@pytest.mark.parametrize("flag", [MISSING, BAD])
def test_an_unknown_taxel_is_nan(flag):
    pressure, _ = Calibrator(Calibration(), 4)(COUNTS, np.array([0, flag, 0, 0], np.uint8))
    np.testing.assert_array_equal(np.isnan(pressure), [False, True, False, False])


def test_a_dead_taxel_is_nan_and_flagged_in_every_frame():
    pressure, flags = Calibrator(Calibration(dead=(3,)), 4)(COUNTS, CLEAR)
    assert np.isnan(pressure[3])
    assert flags[3] == DEAD
    assert not CLEAR.any()  # the caller's flags are not written to


def test_tare_moves_the_zero_of_known_taxels():
    calibrator = Calibrator(Calibration(2.0, no_load=10), 4)
    calibrator.tare(np.array([20.5, np.nan, 4000.0, 50.0]))
    pressure, _ = calibrator(COUNTS, CLEAR)
    np.testing.assert_array_equal(pressure, np.float32([159, 580, 190, 0]))


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({"kpa_per_count": 0.0}, "kpa_per_count is 0.0"),
        ({"kpa_per_count": float("nan")}, "kpa_per_count is nan"),
        ({"no_load": float("inf")}, "no_load is inf"),
        ({"noise_kpa": -1.0}, "noise_kpa is -1.0"),
        ({"shear_n_per_count": 0.0}, "shear_n_per_count is 0.0"),
        ({"shear_n_per_count": float("inf")}, "shear_n_per_count is inf"),
    ],
)
def test_an_impossible_calibration_is_refused(settings, names):
    with pytest.raises(ConfigError, match=names):
        Calibration(**settings)


def test_a_dead_taxel_that_the_array_does_not_have_is_refused():
    with pytest.raises(ConfigError, match="dead names taxel 4: the array has 0 to 3"):
        Calibrator(Calibration(dead=(4,)), 4)


def test_the_noise_floor_is_that_of_rounding():
    values = np.random.default_rng(1).uniform(0, 1000, 200_000)
    assert Calibration(-0.5).floor_kpa == pytest.approx(np.std((np.round(values) - values) * 0.5), rel=0.01)
