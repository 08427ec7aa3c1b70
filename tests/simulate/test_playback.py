from functools import cache
from threading import Event

import numpy as np
import pytest

from tactiled.bus.codec import read_one
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.xela import Xela
from tactiled.calibrate.counts.calibration import Calibration
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.frames import Message
from tactiled.geometry import grid
from tactiled.simulate import player
from tactiled.simulate.playback import SCENE_S, TOUR, play
from tactiled.simulate.scenes import SCENES
from tests.conftest import Clock

KERNEL = solve(Stack((Layer(1.2, 0.6, 0.48),)), "layered")
XELA = Xela(rows=tuple(range(8)), columns=tuple(range(8)))


def two_messages(sequence, _, now):
    return [Message(now, sequence, b""), Message(now, sequence, b"")]


def payloads(codec, messages):
    return [read_one(codec, each).payload for each in messages]


@cache
def packed(scene):
    return player(grid(8, 8, 1.0), KERNEL, Packed(64), Calibration(0.05, 80), scene, 0.0)


@cache
def skinned(scene):
    return player(grid(8, 8, 1.0), KERNEL, XELA, Calibration(0.02, 36_000), scene, 0.0)


def sheared(scene, t):
    """Shear (2, 8, 8) of a skin, counts, and the image beside it."""
    source = skinned(scene)
    parts = payloads(source.codec, source.messages(0, t, 0.0))
    return source.codec.shear(parts).reshape(2, 8, 8), source.codec.unpack(parts).reshape(8, 8)


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr("tactiled.simulate.playback.time", made)
    return made


def test_frames_leave_at_their_rate_and_do_not_drift(clock):
    """Slow frames delay themselves only: the last is as near to its own deadline as the first."""
    times, messages, began = [], [], clock.now

    def slow(sequence, t, now):
        times.append((t, clock.now - began))
        clock.now += 0.003
        return two_messages(sequence, t, now)

    assert play(slow, messages.append, 50.0, clock, 2.0) == 100
    np.testing.assert_allclose(times, np.arange(100)[:, None] * [0.02, 0.02], atol=1e-9)
    assert [each.id for each in messages] == sorted(2 * list(range(100)))
    assert [each.time - began for each in messages] == pytest.approx(np.repeat(np.arange(100) / 50, 2))


def test_a_delay_is_not_followed_by_a_burst(clock):
    at = []

    def delayed(sequence, *_):
        at.append(clock.now)
        clock.now += 0.3 if sequence == 5 else 0.0
        return []

    play(delayed, None, 100.0, clock, 0.5)
    pauses = np.diff(at)
    assert pauses[5] == pytest.approx(0.3)
    assert np.count_nonzero(pauses < 0.0099) == 1


def test_rounding_adds_no_frame():
    assert max(play(two_messages, lambda _: None, 1000.0, Event(), 0.003) for _ in range(50)) == 3


def test_a_player_encodes_its_scene():
    source = packed("sphere")
    codec, surface = source.codec, source.surface
    counts = codec.unpack(payloads(codec, source.messages(7, np.pi / 2, 4.5)))
    assert {each.time for each in source.messages(7, 0.0, 4.5)} == {4.5}
    assert read_one(codec, source.messages(7, 0.0, 4.5)[0]).sequence == 7
    sensed = surface.sense(SCENES["sphere"](surface.x, surface.y, np.pi / 2, surface.size, surface.grain))
    np.testing.assert_allclose((counts - 80.0) * 0.05, sensed, atol=0.0251)
    assert 30 < sensed.max() < 100


def test_an_even_pressure_goes_on_past_the_border():
    source = packed("steps")
    counts = source.codec.unpack(payloads(source.codec, source.messages(0, 12.0, 0.0)))
    np.testing.assert_array_equal(counts, 80 + 20 / 0.05)


@pytest.mark.parametrize(("t", "axis", "sign"), [(0.0, 1, 1), (np.pi / 2, 0, -1), (np.pi, 1, -1)])
def test_motion_drags_a_skin_along(t, axis, sign):
    """The sphere rolls from x to y."""
    shear, image = sheared("sphere", t)
    surface = (source := skinned("sphere")).surface
    pressure = SCENES["sphere"](surface.x, surface.y, t, surface.size, surface.grain)
    aside = (source.felt.apart @ pressure.ravel()).reshape(shear.shape) / 0.02
    total = (shear - aside).sum(axis=(1, 2))
    assert sign * total[axis] > 5 * abs(total[1 - axis])
    assert 0.05 < sign * total[axis] / (image - 36_000.0).sum() < 0.25
    assert shear.dtype == np.float32


def test_a_press_without_motion_squeezes_the_rubber_aside():
    """Two punches, left and right of the middle, at the turn of their way."""
    shear, image = sheared("indenters", np.pi / 0.8)
    assert np.abs(shear.sum(axis=(1, 2))).max() < 0.01 * np.abs(shear).sum()
    row, column = np.unravel_index(image.argmax(), image.shape)
    assert shear[1, row - 1, column] < 0 < shear[1, row + 2, column]


@pytest.mark.parametrize("scene", ["empty", "uniform"])
def test_no_and_even_pressure_give_no_shear(scene):
    assert not sheared(scene, 1.0)[0].any()


def test_a_tour_goes_round_its_scenes():
    """The last scene is empty; the one after it is the first again."""
    source = packed("tour")
    starts = (np.arange(len(TOUR) + 1) + 0.1) * SCENE_S
    sums = [source.codec.unpack(payloads(source.codec, source.messages(0, t, 0.0))).sum() for t in starts]
    assert sums[-2] == 64 * 80
    assert min(*sums[:-2], sums[-1]) > 64 * 80
