from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.config import parse
from tactiled.contacts.regions import Measures, Region, Threshold
from tactiled.errors import StateError
from tactiled.frames import MISSING
from tactiled.geometry import grid, raster
from tactiled.live.region_monitor import MAX_REGIONS, MIN_GAP_S, SERIES_S, RegionMonitor
from tactiled.live.service import Service
from tactiled.live.state_file import StateFile
from tests.conftest import CONFIG

CELLS = raster(grid(4, 4, 1.0), 1)
WEST = Region(
    shape="rectangle",
    points_mm=[[-0.5, -0.5], [1.5, 3.5]],
    threshold=Threshold(quantity="peak", above=50.0, below=40.0),
)


def image(kpa, time, unit="kPa", **others):
    values = np.zeros((4, 4), np.float32)
    values[1, 1], values[1, 3] = kpa, 99.0  # the second is no part of it
    known = {"shares": None, "flags": np.zeros((4, 4), np.uint8), "noise_known": True, "cell_noise": 0.1}
    return SimpleNamespace(restored=values, time=time, unit=unit, **known | others)


@pytest.fixture
def monitor():
    monitor = RegionMonitor(lambda: CELLS)
    monitor.put("west", WEST)
    return monitor


def test_a_threshold_has_hysteresis(monitor):
    crossings = []
    for n, kpa in enumerate([10, 49, 51, 45, 60, 41, 39, 45, 49, 52]):
        monitor.watch(image(kpa, n))
        crossings += [(n, each.above, each.value) for each in monitor.drain_crossings()]
    assert crossings == [(2, True, 51), (6, False, 39), (9, True, 52)]
    assert monitor.series["west"].summary().exceeded


def test_what_is_not_known_crosses_no_threshold_and_is_no_zero(monitor):
    flags, hole = np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.float32)
    flags[:3, :2] = MISSING
    monitor.watch(image(60, 0))
    monitor.watch(image(0, 1, shares=hole, flags=flags))
    monitor.watch(image(0.4, 2, noise_known=False))  # may be noise alone
    monitor.watch(image(60, 3, noise_known=False))  # clear whatever the noise is
    monitor.watch(image(0, 4))
    assert [(each.above, each.value) for each in monitor.drain_crossings()] == [(True, 60), (False, 0)]
    series = monitor.series["west"].series(10, 100)
    np.testing.assert_array_equal(np.isfinite(series.values).all(axis=1), [True, False, False, True, True])
    assert series.missing.tolist() == [0, 6, 0, 0, 0]


def test_peaks_hold_and_integrals_grow_until_a_reset(monitor):
    for n, kpa in enumerate([20, 80, 40]):
        monitor.watch(image(kpa, 100 + 0.5 * n))
    monitor.watch(image(10, 200.0))  # after a gap, over which nothing is known
    summary = monitor.series["west"].summary()
    assert (summary.now.peak, summary.highest.peak, summary.since) == (10, 80, 100)
    assert summary.now.force == pytest.approx(0.010)
    assert summary.impulse == pytest.approx(0.5 * (0.080 + 0.040))
    assert summary.pressure_time == pytest.approx(0.5 * (80 + 40))
    monitor.series["west"].reset()
    monitor.watch(image(30, 200.5))
    summary = monitor.series["west"].summary()
    assert (summary.highest.peak, summary.since, summary.impulse) == (30, 200.5, pytest.approx(0.015))


def test_a_fast_sensors_series_goes_back_as_far_as_any(monitor):
    series = monitor.series["west"]
    series.measure = lambda _: Measures(*4 * (1.0,))
    for n in range(70_000):
        series.watch(image(1, n * 1.01 * MIN_GAP_S))
    time = series.series(SERIES_S, 100_000).time
    assert time[-1] - time[0] == pytest.approx(SERIES_S, abs=2 * MIN_GAP_S)


def test_a_series_is_of_the_last_seconds_and_keeps_peaks_where_it_is_thinned(monitor):
    for n in range(2000):
        monitor.watch(image(90 if n == 1777 else n % 7, n / 100))
    time, values, _, unit = monitor.series["west"].series(10, 100_000)
    assert (len(time), unit) == (1001, "kPa")
    assert time[0] == pytest.approx(9.99)
    time, values, *_ = monitor.series["west"].series(10, 20)
    assert len(time) == 20
    assert (np.diff(time) > 0).all()
    assert (values[:, 2].max(), time[values[:, 2].argmax()]) == (90, 17.77)
    time, values, *_ = monitor.series["west"].series(10, 100_000, 17.77)
    assert (len(time), time[-1], values[-1, 2]) == (1001, 17.77, 90)
    assert len(monitor.series["west"].series(10, 20, -1.0).time) == 0
    monitor.watch(image(5, 20.0, "counts"))  # another unit: a series has one
    time, values, _, unit = monitor.series["west"].series(10, 20)
    assert (len(time), unit, values[0, 0]) == (1, "counts", 5)
    summary = monitor.series["west"].summary()
    assert (summary.highest.peak, summary.impulse, summary.since) == (5, 0, 20.0)


def test_another_threshold_leaves_peaks_and_series_and_is_judged_anew(monitor):
    for n, kpa in enumerate([30, 60, 45]):
        monitor.watch(image(kpa, n))
    before = monitor.series["west"]
    monitor.drain_crossings()
    monitor.put("west", WEST)  # the same: it is still above
    assert before.exceeded
    limit = Threshold(quantity="peak", above=40.0, below=20.0)
    monitor.put("west", WEST.model_copy(update={"threshold": limit}))
    monitor.watch(image(45, 3))
    assert [(each.above, each.value) for each in monitor.drain_crossings()] == [(True, 45)]
    assert monitor.series["west"] is before
    assert before.summary().highest.peak == 60
    with pytest.raises(ValueError, match="below = 50 is more than above = 40"):
        monitor.put("west", WEST.model_copy(update={"threshold": limit.model_copy(update={"below": 50.0})}))
    assert monitor.series["west"].region.threshold == limit
    monitor.put("west", WEST.model_copy(update={"points_mm": ((-0.5, -0.5), (2.5, 3.5))}))
    assert monitor.series["west"] is not before


def test_more_regions_than_there_is_memory_for_are_refused(monitor):
    for n in range(MAX_REGIONS - 1):
        monitor.put(f"r{n}", WEST)
    monitor.put("r3", WEST)  # one that is there may be replaced
    with pytest.raises(ValueError, match="16 regions"):
        monitor.put("more", WEST)


def service(path):
    return Service(parse(CONFIG.format(channel="none")), state=StateFile(path))


def test_regions_outlive_a_restart_and_one_that_cannot_be_kept_changes_nothing(tmp_path):
    path = tmp_path / "state.json"
    first = service(path)
    palm = first.sensor("palm")
    first.regions.put(palm, "west", WEST)
    again = service(path)
    assert again.sensor("palm").regions.regions == {"west": WEST}
    path.unlink()
    path.mkdir()  # nothing can be written there
    other = Region(shape="ellipse", points_mm=[[0, 0], [3, 3]])
    watched = WEST.model_copy(update={"threshold": Threshold(quantity="force", above=5.0, below=4.0)})
    for region in (other, watched, None):
        with pytest.raises(StateError, match="nothing was kept"):
            first.regions.put(palm, "west", region) if region else first.regions.remove(palm, "west")
        assert palm.regions.regions == {"west": WEST}


def test_a_kept_region_that_no_longer_fits_is_an_event(tmp_path):
    path = tmp_path / "state.json"
    distant = WEST.model_copy(update={"points_mm": ((500.0, 500.0), (510.0, 510.0))})
    StateFile(path).keep_regions("palm", {"away": distant})
    events = [(each.kind, each.text) for each in service(path).events.after(0)]
    assert events == [
        ("region_ignored", "sensor palm, region away: points_mm: no cell of the image has its centre in it")
    ]
