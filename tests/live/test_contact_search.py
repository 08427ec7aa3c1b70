import time

import numpy as np
import pytest

from tactiled.contacts.detection import Finder
from tactiled.live import contact_search
from tests.conftest import GAIN, NO_LOAD, SIDE, until


def bump(x, y=3.4, kpa=200):
    """Counts of a smooth press off the grid."""
    down, right = np.mgrid[:SIDE, :SIDE]
    return NO_LOAD + np.round(kpa / GAIN * np.exp(-((right - x) ** 2 + (down - y) ** 2) / 2)).astype(int)


def ids(rig):
    return [each.id for each in rig.sensor.contacts()[1]]


@pytest.fixture
def searches(monkeypatch):
    """When (s) each image was searched for contacts."""
    times, search = [], Finder.__call__

    def noted(*args, **more):
        times.append(time.monotonic())
        return search(*args, **more)

    monkeypatch.setattr(Finder, "__call__", noted)
    return times


def test_a_contact_that_moves_between_two_questions_keeps_its_id(rig):
    rig.show(bump(1.3))
    assert ids(rig) == [1]
    for x in np.arange(1.3, 6.4, 0.15):
        rig.show(bump(x))
        time.sleep(0.03)
    (contact,) = rig.sensor.contacts()[1]
    assert contact.id == 1
    assert contact.x_mm == pytest.approx(6.3, abs=0.3)


def test_searches_have_a_steady_pace_and_end_some_time_after_the_last_question(rig, searches, monkeypatch):
    monkeypatch.setattr(contact_search, "ASKED_S", 0.6)
    with rig.playing(200):
        until(rig.sensor.hub.latest)
        time.sleep(0.3)
        assert not searches  # no question yet
        asked_at = time.monotonic()
        rig.sensor.contacts()
        until(lambda: len(searches) > 4)
        assert np.diff(searches).min() > 0.8 * contact_search.LOOK_S
        until(lambda: time.monotonic() > asked_at + 0.8)
        count = len(searches)
        time.sleep(0.3)
        assert len(searches) == count
        rig.sensor.contacts()
        assert len(searches) > count


def test_a_search_that_fails_raises_to_the_question_and_ends_no_search(rig, searches, monkeypatch):
    rig.show(bump(2.2))
    assert ids(rig) == [1]
    with monkeypatch.context() as broken:
        broken.setattr(Finder, "__call__", lambda *_, **__: 1 / 0)
        rig.show(bump(2.4))
        time.sleep(3 * contact_search.LOOK_S)
        with pytest.raises(ZeroDivisionError):
            ids(rig)
    count = len(searches)
    until(lambda: len(searches) > count)  # without a question
    assert ids(rig) == [1]
