from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.build import make_stack
from tactiled.frames import FAULTY
from tactiled.guided.cover_procedure import CoverProcedure
from tactiled.guided.frame_collector import FrameCollector
from tactiled.guided.live_presses import LiveContact, LivePresses, presses_of
from tests.calibrating import LOAD, RATE_HZ, CalibratedSkin


@pytest.fixture
def skin(rig):
    rig.stale_after(600)
    return CalibratedSkin(rig, spread=0.0)


@pytest.fixture
def collector(rig):
    collector = FrameCollector(rig.sensor.array.size)
    rig.sensor.frames.subscribe(collector.add)
    return collector


def test_presses_that_come_are_those_of_all_frames_whenever_they_are_looked_at(rig, skin, collector):
    live, random = LivePresses(rig.sensor, border=False), np.random.default_rng(3)
    tips = [3 * skin.world.tip(0.5, place) for place in skin.world.places(6, random)]
    frames = np.concatenate([np.zeros((40, 64)), *(LOAD[:, None] * each for each in tips), np.zeros((60, 64))])
    at = 0
    for step in random.integers(5, 60, 100):
        skin.offer(frames[at : at + step])
        live.look(collector)
        at += step
    expected = presses_of(rig.sensor, collector.series(), border=False)
    assert len(live.usable) == len(expected) == 6
    np.testing.assert_allclose(
        [each.place_mm for each in live.usable], [each.place_mm for each in expected], atol=0.02
    )
    assert not live.waiting


def test_a_saturated_press_and_a_load_that_never_ends_are_named(rig, skin, collector):
    live = LivePresses(rig.sensor, border=False)
    place = rig.sensor.array.positions.mean(axis=0)
    skin.offer(
        np.concatenate([np.zeros((40, 64)), 21 * LOAD[:, None] * skin.world.tip(0.5, place), np.zeros((40, 64))])
    )
    live.look(collector)
    assert (live.saturated, len(live.usable)) == (1, 0)
    assert live.ended[0].reason.startswith("saturated")
    other = LivePresses(rig.sensor, border=False)
    later = FrameCollector(64)
    rig.sensor.frames.subscribe(later.add)
    skin.offer(np.tile(3 * skin.world.tip(0.5, place), (80, 1)))
    other.look(later)
    assert "no frame is without a load" in other.waiting


def test_contact_is_timed(rig, skin, collector):
    contact = LiveContact(rig.sensor)
    touched = 3 * skin.world.tip(0.5, rig.sensor.array.positions.mean(axis=0))
    for load in (0, 1, 0, 1):
        skin.offer(load * np.tile(touched, (2 * RATE_HZ, 1)))
        contact.look(collector)
    assert contact.seconds == pytest.approx(4.0, abs=0.1)


def test_a_fit_leaves_out_taxels_that_are_found_faulty(rig, collector):
    rig.sensor.pipeline.calibrator.faulty[[7, 27]] = FAULTY
    procedure, fitted = CoverProcedure(rig.sensor, make_stack(rig.config.sensor["palm"]), "tip", 1.0), []
    fit = SimpleNamespace(
        run=lambda _, recorded, *_rest: fitted.append(recorded) or SimpleNamespace(reason="none", objection="")
    )
    procedure.fit(collector.series(), fit)
    assert fitted[0].calibration.dead == (7, 27)
