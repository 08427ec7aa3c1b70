import sys
from threading import Event, Timer

import numpy as np
import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.xela import Xela
from tactiled.calibrate.calibration import Calibration
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import ConfigError
from tactiled.frames import Message
from tactiled.geometry import grid
from tactiled.simulate import play, player
from tactiled.simulate.play import STAY_S, TOUR
from tests.conftest import Clock


def one(sequence, _, now):
    return [Message(now, sequence, b""), Message(now, sequence, b"")]


def counts_of(codec, messages):
    return codec.unpack([codec.decode(each).payload for each in messages])


@pytest.fixture(scope="module")
def make():
    kernel = solve(Stack((Layer(1.2, 0.6, 0.48),)), "layered")

    def players(scene):
        return player(grid(8, 8, 1.0), kernel, Packed(64), Calibration(0.05, 80), scene, 0.0)

    return players


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(sys.modules["tactiled.simulate.play"], "time", made)
    return made


def test_frames_leave_at_their_rate_and_do_not_drift(clock):
    """Slow frames delay themselves only: the last is as near to its own deadline as the first."""
    sent, began = [], clock.now

    def slow(sequence, t, now):
        sent.append((t, clock.now - began))
        clock.now += 0.003
        return one(sequence, t, now)

    assert play(slow, lambda _: None, 50.0, clock, 2.0) == 100
    np.testing.assert_allclose(sent, np.arange(100)[:, None] * [0.02, 0.02], atol=1e-9)


def test_a_hold_up_is_not_made_good_by_a_burst(clock):
    at = []

    def held_up(sequence, t, now):
        at.append(clock.now)
        if sequence == 5:
            clock.now += 0.3
        return one(sequence, t, now)

    play(held_up, lambda _: None, 100.0, clock, 0.5)
    gaps = np.diff(at)
    assert gaps[5] == pytest.approx(0.3)
    assert np.count_nonzero(gaps < 0.0099) == 1


def test_messages_go_out_in_order_with_the_time_of_their_frame(clock):
    sent, began = [], clock.now
    play(one, sent.append, 200.0, clock, 0.05)
    assert [each.id for each in sent] == sorted(2 * list(range(10)))
    assert [each.time - began for each in sent] == pytest.approx(np.repeat(np.arange(10) / 200, 2))


def test_rounding_sends_no_frame_more_than_was_asked_for():
    assert max(play(one, lambda _: None, 1000.0, Event(), 0.003) for _ in range(50)) == 3


def test_the_stop_is_seen_between_two_frames():
    stop = Event()
    Timer(0.1, stop.set).start()
    assert play(one, lambda _: None, 1.0, stop) == 1


def test_a_player_encodes_its_scene(make):
    source = make("uniform")
    codec = source.codec
    counts = counts_of(codec, source.messages(7, np.pi / 2, 4.5))
    assert {each.time for each in source.messages(7, 0.0, 4.5)} == {4.5}
    assert codec.decode(source.messages(7, 0.0, 4.5)[0]).sequence == 7
    sensed = source.surface.sense(np.full_like(source.surface.x, 60.0))  # kPa, the scene's peak
    np.testing.assert_allclose((counts - 80.0) * 0.05, sensed, atol=0.0251)
    assert 50 < sensed.max() < 60


@pytest.fixture(scope="module")
def skin():
    kernel = solve(Stack((Layer(1.2, 0.6, 0.48),)), "layered")
    codec = Xela(rows=tuple(range(8)), columns=tuple(range(8)))
    return lambda scene: player(grid(8, 8, 1.0), kernel, codec, Calibration(0.02, 36_000), scene, 0.0)


def shear_of(source, t):
    """(2, 8, 8) counts, and the image beside it."""
    payloads = [source.codec.decode(each).payload for each in source.messages(0, t, 0.0)]
    return source.codec.shear(payloads).reshape(2, 8, 8), source.codec.unpack(payloads).reshape(8, 8)


@pytest.mark.parametrize(("t", "axis", "sign"), [(0.0, 1, 1), (np.pi / 2, 0, -1), (np.pi, 1, -1)])
def test_what_moves_drags_a_skin_that_feels_it_along(skin, t, axis, sign):
    """The sphere rolls from x to y."""
    shear, image = shear_of(skin("sphere"), t)
    total = shear.sum(axis=(1, 2))
    assert sign * total[axis] > 5 * abs(total[1 - axis])
    assert 0.05 < sign * total[axis] / (image - 36_000.0).sum() < 0.25
    assert shear.dtype == np.float32


def test_what_presses_without_moving_squeezes_the_rubber_aside(skin):
    """Two punches, left and right of the middle, at the turn of their way."""
    shear, image = shear_of(skin("indenters"), np.pi / 0.8)
    assert np.abs(shear.sum(axis=(1, 2))).max() < 0.01 * np.abs(shear).sum()
    row, column = np.unravel_index(image.argmax(), image.shape)
    assert shear[1, row - 1, column] < 0 < shear[1, row + 2, column]


def test_nothing_and_even_pressure_at_rest_give_no_shear(skin):
    assert not shear_of(skin("empty"), 1.0)[0].any()
    assert not shear_of(skin("uniform"), 1.0)[0].any()


def test_a_tour_goes_round_its_scenes(make):
    """The last stay is empty; the one after is the first again."""
    source = make("tour")
    sums = [
        counts_of(source.codec, source.messages(0, (n + 0.1) * STAY_S, 0.0)).sum() for n in range(len(TOUR) + 1)
    ]
    assert sums[-2] == 64 * 80
    assert min(sums[:-2]) > 64 * 80
    assert sums[-1] > 64 * 80


def test_a_scene_that_is_not_there_is_refused_with_those_that_are(make):
    with pytest.raises(ConfigError, match="scene = 'rain': no such scene: choose tour or one of ring, "):
        make("rain")
