"""Frames of a scene at an array's rate, encoded for a bus."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event

import numpy as np

from tactiled.arrays import Floats
from tactiled.bus.codec import Codec, ShearCodec
from tactiled.calibrate.counts.calibration import Calibration
from tactiled.cover.kernel import Kernel
from tactiled.cover.tangential import Responses, responses
from tactiled.errors import ConfigError
from tactiled.frames import Message
from tactiled.geometry import Array
from tactiled.simulate.array import Surface, Taxels
from tactiled.simulate.scenes import SCENES, Scene

TOUR = ("ring", "indenters", "sphere", "edge", "fingertip", "empty")
REQUEST_WAIT_S = 0.05  # bounds how late a stop takes effect
SCENE_S = 8.0  # of a tour in each scene
ROUNDING_S = 1e-6  # of deadlines: a frame due this close before the end belongs behind it
FRICTION = 0.25  # tangential load over pressure where what touches slides; made up, so that there is some to see
SLOW_MM_S = 2.0  # speed at which it is half of that
MOTION_S = 0.01  # over which motion is looked at


@dataclass(frozen=True, slots=True, eq=False)
class Player:
    """One simulated array: what it sends at any time."""

    codec: Codec
    surface: Surface
    taxels: Taxels
    scenes: tuple[str, ...]
    felt: Responses | None = None  # of a tangential load, where the skin feels it and the cover holds it

    def messages(self, sequence: int, t: float, now: float) -> list[Message]:
        """The messages of frame `sequence`, `t` s into the play, stamped `now` (s)."""
        scene = SCENES[self.scenes[int(t / SCENE_S) % len(self.scenes)]]
        surface = self.surface
        pressure = scene(surface.x, surface.y, t, surface.size, surface.grain)
        sensed = _sensed(surface, pressure)
        if self.felt is None or not isinstance(self.codec, ShearCodec):
            return self.codec.encode(self.taxels.count(sensed), sequence, now)
        load = _drag(scene, surface, t).ravel()
        ends = pressure * (np.ptp(pressure) > 0)  # an even one does not, and drives no rubber apart
        shear = (self.felt.tangential @ load + self.felt.apart @ ends.ravel()).reshape(2, -1)
        counts = self.taxels.count(sensed + self.felt.tilt @ load)
        return self.codec.encode_sheared(counts, self.taxels.shear(shear), sequence, now)


def _drag(scene: Scene, surface: Surface, t: float) -> Floats:
    """Load (2, rows, columns) in kPa on the surface at `t` s, along x and y: as the pressure's centre moves."""
    now, before = (scene(surface.x, surface.y, at, surface.size, surface.grain) for at in (t, t - MOTION_S))
    if not (now.any() and before.any()):
        return np.zeros((2, *now.shape))
    centre, old_centre = (
        np.array([(each * x).sum() for x in (surface.x, surface.y)]) / each.sum() for each in (now, before)
    )  # mm
    speed = (centre - old_centre) / MOTION_S
    friction = FRICTION * speed / (np.hypot(*speed) + SLOW_MM_S)
    return np.asarray(friction[:, None, None] * now)


def _sensed(surface: Surface, pressure: Floats) -> Floats:
    """What taxels (N,) sense of a pressure; an even one goes on past the border, as under an air bag."""
    even = float(pressure.flat[0])
    return np.full(surface.taxels, even) if (pressure == even).all() else surface.sense(pressure)


def check_scene(scene: str) -> None:
    """ConfigError for a scene that there is none of."""
    if scene != "tour" and scene not in SCENES:
        raise ConfigError(f"scene = {scene!r}: no such scene: choose tour or one of {', '.join(SCENES)}")


def player(
    array: Array,
    kernel: Kernel,
    codec: Codec,
    calibration: Calibration,
    scene: str = "tour",
    noise_kpa: float = 0.1,
) -> Player:
    """Make a player of one scene, or of a tour through them; ConfigError for an unknown scene."""
    check_scene(scene)
    taxels = Taxels(calibration, codec.full_scale, noise_kpa, seed=0)
    surface, feels = Surface(kernel, array), isinstance(codec, ShearCodec) and all(kernel.stack.bonds)
    felt = responses(kernel.stack, array, surface.cells, surface.grain) if feels else None
    return Player(codec, surface, taxels, TOUR if scene == "tour" else (scene,), felt)


def answer(
    source: Player,
    receive: Callable[[float], Message | None],
    send: Callable[[Message], None],
    stop: Event,
    seconds: float = float("inf"),
) -> int:
    """Answer the requests of a polled skin until `stop` or for `seconds`; returns how many."""
    polls = {poll.message._replace(time=0.0): poll.segments for poll in source.codec.polling.polls}
    began, answered = time.monotonic(), 0
    while not stop.is_set() and (t := time.monotonic() - began) < seconds:
        request = receive(REQUEST_WAIT_S)
        segments = polls.get(request._replace(time=0.0)) if request else None
        if segments is not None:
            messages = source.messages(answered, t, time.time())
            for each in segments:
                send(messages[each])
            answered += 1
    return answered


def play(
    source: Callable[[int, float, float], list[Message]],
    send: Callable[[Message], None],
    rate_hz: float,
    stop: Event,
    seconds: float = float("inf"),
) -> int:
    """Send `source`'s frames at `rate_hz` until `stop` or for `seconds`; returns how many.

    Every frame has its own deadline, so that the rate does not drift; a frame that is late by more than its period
    delays the next ones instead of sending them in a burst.
    """
    began = due = time.monotonic()
    sequence = 0
    while due - began < seconds - ROUNDING_S and not stop.wait(max(0.0, due - time.monotonic())):
        for message in source(sequence, due - began, time.time()):
            send(message)
        sequence += 1
        due = max(due + 1 / rate_hz, time.monotonic() - 1 / rate_hz)
    return sequence
