from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tactiled.calibrate.cover.fit import CoverFit
from tactiled.frames import SATURATED, Loss, RawFrame
from tactiled.live import cover_monitor
from tactiled.live.cover_monitor import CONTACTS, EVERY_FRAMES, PAUSE, ZERO_FRAMES, CoverMonitor, Steep
from tactiled.live.events import Events, Faults
from tactiled.live.pipeline import Pipeline
from tactiled.live.sensor import Sensor
from tactiled.live.watch import Watch
from tactiled.simulate.array import Surface
from tactiled.simulate.scenes import SCENES
from tests.calibrate.files import gain_section
from tests.plans import plan

SIDE, THICKNESS, NOISE = 16, 1.5, 0.2
SOUND = np.zeros((SIDE, SIDE), np.uint8)
UNCALIBRATED = plan((SIDE, SIDE), THICKNESS, substrate=True)
CURVES = gain_section(np.full(SIDE**2, 0.1)).curves
SKIN = replace(UNCALIBRATED, calibration=replace(UNCALIBRATED.calibration, curves=CURVES))


@cache
def contacts(factor=1.0, count=8):
    """Frames of contacts with a lift after each, under a cover `factor` times as thick as configured."""
    skin = Surface(plan((SIDE, SIDE), factor * THICKNESS, substrate=True).kernel, SKIN.array, finer=8)
    random, frames = np.random.default_rng(5), []
    gains = 1 + 0.01 * random.normal(size=SIDE**2)
    for n in range(count):
        scene, start = SCENES[("ring", "indenters", "edge", "sphere")[n % 4]], random.uniform(0, 60)
        pressure = [scene(skin.x, skin.y, start + 0.04 * step, skin.size, skin.grain) for step in range(6)]
        frames += [gains * skin.sense(each) for each in pressure] + [np.zeros(SIDE**2)]
    return (np.array(frames) + random.normal(0, NOISE, (len(frames), SIDE**2))).reshape(-1, SIDE, SIDE)


def searched(monitor, frames, now=0.0, flags=SOUND):
    """What is known after a search at `now` (s) that has `frames`."""
    for frame in np.repeat(frames.astype(np.float32), EVERY_FRAMES, axis=0):
        monitor.observe(frame, flags, NOISE)
    monitor.search(now)
    if monitor._running:
        assert monitor._running.poll(240)  # its process gives way to all others
        monitor.search(now)
    return monitor.warning


@pytest.mark.parametrize(("factor", "direction"), [(1.25, "thicker"), (0.75, "thinner")])
def test_a_cover_of_another_thickness_is_named_with_its_direction_and_interval(factor, direction):
    (named,) = searched(CoverMonitor(SKIN), contacts(factor))
    low, high = named.interval_mm
    assert (named.code, named.direction) == ("cover_mismatch", direction)
    assert low < factor * THICKNESS < high < 1.3 * low
    assert named.thickness_mm == pytest.approx(factor * THICKNESS, rel=0.06)
    assert f"the cover is {direction} than configured" in named.text


def test_a_cover_as_configured_is_judged_and_names_none():
    monitor = CoverMonitor(SKIN)
    assert searched(monitor, contacts()) == ()
    assert len(monitor._profiles.snr) == CONTACTS


def test_contacts_are_those_over_the_zero_just_before_them_however_it_drifts():
    monitor, random = CoverMonitor(SKIN), np.random.default_rng(6)
    pressed = np.split(contacts(count=3), 3)  # of 7 frames, the last one free
    frames = np.concatenate([[*random.normal(0, NOISE, (80, SIDE, SIDE)), *each] for each in pressed])
    drift = np.linspace(0, 3 * NOISE, len(frames))[:, None, None] * np.linspace(0.5, 1.5, SIDE)
    for frame in np.repeat((frames + drift).astype(np.float32), EVERY_FRAMES, axis=0):
        monitor.observe(frame, SOUND, NOISE)
    assert len(monitor._waiting) == 3
    for kept in monitor._waiting:
        seen = NOISE * kept.frames[kept.place]
        clean = min(frames, key=lambda each: np.abs(each - seen).sum())
        assert np.abs((seen - clean).mean(axis=0)).max() < 0.9 * NOISE  # the drift is 4.5 times the noise
        assert kept.zero_variance == 1 / ZERO_FRAMES


@pytest.fixture
def searches(monkeypatch):
    """Contacts of each search; each gives the next of `factors`."""

    class Search(list):
        factors = ()

        def __call__(self, _function, _profiles, frames, *_others):
            self.append(len(frames))
            return self

        def poll(self, *_seconds):
            return True

        def recv(self):
            factor, *self.factors = self.factors
            ends = 0.99 * factor, 1.01 * factor
            return ("profiles", CoverFit("blind", factor, ends, factor * THICKNESS, (1, 2), 8)), None

    search = Search()
    monkeypatch.setattr(cover_monitor, "start", search)
    return search


def test_none_is_judged_without_calibrated_gains_or_from_saturated_frames_or_few_contacts(searches):
    searched(CoverMonitor(UNCALIBRATED), contacts(1.25))
    flags = SOUND.copy()
    flags[0, 0] = SATURATED
    searched(CoverMonitor(SKIN), contacts(1.25), flags=flags)
    searched(CoverMonitor(SKIN), contacts(1.25, CONTACTS - 1))
    assert searches == []


@pytest.mark.parametrize("shape", [(1, 16), (16, 1), (1, 1)])
def test_an_array_of_one_row_or_column_is_not_judged(shape, searches):
    skin, curves = plan(shape, THICKNESS), gain_section(np.full(shape[0] * shape[1], 0.1)).curves
    monitor = CoverMonitor(replace(skin, calibration=replace(skin.calibration, curves=curves)))
    rows = contacts()[:, SIDE // 2]
    searched(monitor, np.resize(rows, (len(rows), *shape)), flags=np.zeros(shape, np.uint8))
    assert searches == []


def test_a_warning_ends_with_the_next_judgement_and_with_a_tare(searches):
    """A factor within 15 % is never named, however narrow its interval."""
    searches.factors = 1.25, 1.14, 1.25
    pipeline = Pipeline(SKIN)
    monitor = pipeline.cover
    assert searched(monitor, contacts())[0].direction == "thicker"
    assert searched(monitor, contacts(count=1), 1.0) == ()
    assert searched(monitor, contacts(count=2), 2.0)[0].direction == "thicker"
    assert searches == [CONTACTS, 1, 2]
    pipeline.set_zero(pipeline.zero)
    assert searched(monitor, contacts(count=1), 3.0) == ()


def test_a_search_rests_a_hundred_times_as_long_as_it_took(searches):
    searches.factors = 1.25, 1.25
    monitor = CoverMonitor(SKIN)
    monitor._waiting = [Steep(0.1, [SOUND], 0, 0.0)] * CONTACTS
    for now in (0.0, 2.0, 2.0 + 1.9 * PAUSE, 2.0 + 2 * PAUSE):
        assert len(searches) == (now > 0.0)
        monitor.search(now)
        monitor._waiting = [Steep(0.1, [SOUND], 0, 0.0)]
    assert searches == [CONTACTS, 1]


def test_a_sensor_that_runs_is_searched_by_the_watch_and_its_images_warn(searches):
    searches.factors = (1.25,)
    calibration = replace(SKIN.calibration, noise_kpa=NOISE)
    sensor, events = Sensor(replace(SKIN, method="raw", calibration=calibration)), Events()
    watch = Watch([sensor], events, Faults(events), str)
    for counts in np.repeat(contacts().reshape(-1, SIDE**2) / 0.1, EVERY_FRAMES, axis=0).astype(np.float32):
        sensor.restore(RawFrame(0, 0.0, 0.0, counts, SOUND.ravel(), Loss()))
    for now in (0.0, 1.0):
        watch.look(now)
    sensor.restore(RawFrame(0, 0.0, 0.0, counts, SOUND.ravel(), Loss()))
    assert searches == [CONTACTS]
    assert sensor.hub.latest().warnings[-1].direction == "thicker"
