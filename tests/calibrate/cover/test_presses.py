import numpy as np
import pytest

from tactiled.calibrate.counts.calibration import Calibration
from tactiled.calibrate.cover.presses import _ceiling, find_presses
from tactiled.calibrate.cover.recorded_presses import recorded_presses
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import grid
from tests.touched import World, recorded, rubber

ARRAY = grid(14, 14, 1.0)
WORLD = World(ARRAY, rubber(1.0))


@pytest.fixture
def random():
    return np.random.default_rng(41)


def test_presses_are_means_over_their_plateaus_whatever_drifts_meanwhile(random):
    places = WORLD.places(6, random)
    pressures = np.array([WORLD.tip(0.8, place) for place in places])
    frames = recorded(pressures, random)
    frames += np.linspace(0, 2, len(frames), dtype=np.float32)[:, None] * random.normal(size=ARRAY.size)
    frames[:, 20] = np.nan
    frames[random.random(frames.shape) < 0.01] = np.nan
    frames[50] = np.nan  # a frame that was lost
    presses = find_presses(frames, ARRAY, 1.0)
    assert [each.reason for each in presses] == [""] * 6
    for press, place, pressure in zip(presses, places, pressures, strict=True):
        assert np.hypot(*(np.array(press.place_mm) - place)) < 0.15
        assert 25 <= press.end - press.start <= 36
        works = np.arange(ARRAY.size) != 20
        scaled = ((press.mean - pressure) / press.error)[works]
        assert np.isnan(press.mean[20])
        assert 0.9 < np.sqrt(np.mean(scaled**2)) < 1.15
        assert press.force_n == pytest.approx(pressure[works].sum() / 1e3, rel=0.03)


def test_presses_that_cannot_be_used_are_listed_with_their_reason(random):
    middle = WORLD.tip(0.8, np.array([6.2, 7.1]))
    sliding = [WORLD.tip(0.8, np.array([x, 6.0])) for x in np.linspace(3, 11, 40)]
    weak, border = 0.04 * WORLD.tip(0.8, np.array([4.0, 9.0])), WORLD.tip(0.8, np.array([-0.3, 6.0]))
    frames = recorded(np.array([middle, weak, border, middle]), random)
    slide = recorded(np.array([middle]), random)
    slide[35:65] = 0
    slide[32:72] = np.array(sliding)[: len(slide[32:72])]
    frames = np.concatenate([frames, slide])
    saturated = np.zeros(frames.shape, bool)
    last = 4 * 70 - 20
    saturated[last, :3] = True
    reasons = [each.reason for each in find_presses(frames, ARRAY, 1.0, saturated)]
    assert reasons[0] == ""
    assert reasons[1].startswith("hardly leaves the noise: its peak is ")
    assert reasons[2] == "reaches over the array's border"
    assert reasons[3] == "saturated: 3 taxels at their ceiling, press less hard"
    assert _ceiling(np.eye(1, 3, dtype=bool)) == "saturated: 1 taxel at its ceiling, press less hard"
    assert reasons[4].startswith("never stands still: ")
    assert find_presses(frames, ARRAY, 1.0, border=True)[2].reason == ""
    assert find_presses(frames[45:], ARRAY, 1.0)[0].reason == "lay there before the first frame"


def test_a_recording_of_nothing_has_no_press_and_one_without_a_pause_is_refused(random):
    assert not find_presses(random.normal(0, 1, (3000, ARRAY.size)), ARRAY, 1.0)
    steady = WORLD.tip(0.8, np.array([6.0, 6.0])) + random.normal(0, 1, (50, ARRAY.size))
    with pytest.raises(ConfigError, match=r"no frame is without a load .*contact of .* kPa"):
        find_presses(steady, ARRAY, 1.0)


def test_noisy_and_dead_taxels_are_left_out_and_seem_no_press(random):
    frames = recorded(np.array([WORLD.tip(0.8, place) for place in WORLD.places(3, random)]), random)
    frames[:, 90] += random.normal(0, 40, len(frames))
    series = FrameSeries(np.arange(len(frames)) / 100, np.round(100 + 10 * frames).astype(np.float32))
    presses = recorded_presses(series, ARRAY, Calibration(0.1, 200, dead=(20,)), (0, 65535))
    assert [each.reason for each in presses] == [""] * 3
    assert [np.flatnonzero(np.isnan(each.mean)).tolist() for each in presses] == [[20, 90]] * 3
