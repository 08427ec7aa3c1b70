import threading
import time

import numpy as np
import pytest

from tactiled.runtime import contact_tracking
from tests.conftest import GAIN, NO_LOAD, SIDE, until


def bump(x, y, kpa=200):
    """Counts of a smooth press off the grid."""
    down, right = np.mgrid[:SIDE, :SIDE]
    return NO_LOAD + np.round(kpa / GAIN * np.exp(-((right - x) ** 2 + (down - y) ** 2) / 2)).astype(int)


def ids(rig):
    return [each.id for each in rig.sensor.contacts()[1]]


@pytest.fixture
def looks(rig, monkeypatch):
    """The times of the looks that found another image."""
    seen, finder = [], rig.sensor._touch._finder

    def noted(*args, **more):
        seen.append(time.monotonic())
        return finder(*args, **more)

    monkeypatch.setattr(rig.sensor._touch, "_finder", noted)
    return seen


def test_a_contact_that_moves_between_two_questions_keeps_its_id(rig):
    rig.show(bump(1.3, 3.4))
    assert ids(rig) == [1]
    for x in np.arange(1.3, 6.4, 0.15):
        rig.show(bump(x, 3.4))
        time.sleep(0.03)
    (contact,) = rig.sensor.contacts()[1]
    assert contact.id == 1
    assert contact.x_mm == pytest.approx(6.3, abs=0.3)


def test_between_questions_looks_come_at_a_steady_pace_and_end_some_time_after_the_last(rig, looks, monkeypatch):
    monkeypatch.setattr(contact_tracking, "ASKED_S", 0.6)
    ended = threading.Event()

    def play():
        while not ended.wait(0.005):
            rig.send(bump(3.2, 3.4))

    thread = threading.Thread(target=play)
    thread.start()
    try:
        until(lambda: rig.sensor.hub.latest())
        time.sleep(0.3)
        assert not looks  # nobody has asked
        asked = time.monotonic()
        assert ids(rig) == [1]
        until(lambda: len(looks) > 4)
        assert np.diff(looks).min() > 0.8 * contact_tracking.LOOK_S
        until(lambda: time.monotonic() > asked + 0.8)
        count = len(looks)
        time.sleep(0.3)
        assert len(looks) == count
        assert ids(rig) == [1]
    finally:
        ended.set()
        thread.join()


def test_who_asks_is_told_of_the_newest_image_however_soon(rig):
    for step in range(5):
        image = rig.show(bump(2.2 + step / 2, 3.4))
        looked, (contact,) = rig.sensor.contacts()
        assert looked is image
        assert contact.x_mm == pytest.approx(2.2 + step / 2, abs=0.1)


def test_a_look_that_fails_is_told_to_who_asks_and_ends_nothing(rig, monkeypatch):
    rig.show(bump(2.2, 3.4))
    assert ids(rig) == [1]
    with monkeypatch.context() as broken:
        broken.setattr(rig.sensor._touch, "_finder", lambda *_, **__: 1 / 0)
        rig.show(bump(2.4, 3.4))
        time.sleep(3 * contact_tracking.LOOK_S)
        with pytest.raises(ZeroDivisionError):
            ids(rig)
    until(lambda: rig.sensor._touch._image is rig.sensor.hub.latest())  # without being asked
    assert ids(rig) == [1]
