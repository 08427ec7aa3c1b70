import numpy as np
import pytest

from tactiled.calibrate.upkeep.creep import CreepMeter

TAXELS, PERIOD_S = 60, 2.0
HOUR = 3600.0


def steady(t):
    del t
    return 1.0


def measure(growth, seconds=HOUR, seed=1, noise=0.01, ramp_s=0.0):
    """Creep of a load that lies on a third of the taxels after 100 s; `growth`(t) is over its value at first."""
    random, meter = np.random.default_rng(seed), CreepMeter()
    under = np.arange(TAXELS) < TAXELS // 3
    weights = random.uniform(0.5, 1.5, TAXELS)
    for time_s in np.arange(0, 100 + seconds, PERIOD_S):
        t = time_s - 100
        strength = 0.0 if t < 0 else min(t / ramp_s, 1.0) * growth(t) if ramp_s else growth(t)
        load = (under * weights * strength + random.normal(0, noise, TAXELS)).astype(np.float32)
        meter.update(time_s, load, load > 0.1)
    return meter.creep


@pytest.mark.parametrize("ramp_s", [0.0, 10.0])
@pytest.mark.parametrize("percent", [-3.0, 1.0, 4.0])
def test_creep_is_the_growth_in_a_decade_of_time_with_its_error(percent, ramp_s):
    creep = measure(lambda t: 1 + percent / 100 * np.log10(max(t, 1) / 30), ramp_s=ramp_s)
    assert creep.significant
    assert creep.taxels == TAXELS // 3
    assert creep.percent_per_decade == pytest.approx(
        percent, abs=max(4 * creep.standard_error, 0.1 * abs(percent))
    )
    assert creep.standard_error < 0.2


def test_a_load_that_does_not_creep_shows_none():
    slopes = [measure(steady, 900, seed) for seed in range(40)]
    assert not any(each.significant for each in slopes)
    inside = [abs(each.percent_per_decade) < 2 * each.standard_error for each in slopes]
    assert np.mean(inside) > 0.85


def test_a_load_that_changes_or_lifts_starts_over():
    assert measure(lambda t: 1.0 + 0.5 * (t > 1800), 1850) is None
    assert measure(lambda t: float(t < 1800), 1850) is None
    assert measure(steady, 60) is None
