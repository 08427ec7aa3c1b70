"""Frames of a skin that somebody calibrates, offered to a rig's sensor at times of our own."""

import numpy as np

from tactiled.build import make_stack
from tactiled.frames import Loss, RawFrame
from tests.conftest import GAIN, NO_LOAD
from tests.touched import World

RATE_HZ = 50
TRUE_FACTOR = 1.3  # of the cover's thickness over the configured one
TIP_MM = 1.0
LOAD = np.concatenate([np.zeros(20), np.linspace(0, 1, 8), np.ones(25), np.linspace(1, 0, 8), np.zeros(20)])


class CalibratedSkin:
    """Offers frames; taxels differ in their gain by 20 %."""

    def __init__(self, rig, spread=0.2):
        self.sensor, self.random = rig.sensor, np.random.default_rng(17)
        self.gain = GAIN * np.exp(self.random.normal(0, spread, rig.sensor.array.size))  # kPa per count
        self.sequence, self.noise_kpa = 0, 0.3
        stack = make_stack(rig.config.sensor["palm"]).thickened(TRUE_FACTOR)
        self.world = World(rig.sensor.array, stack)

    def offer(self, pressure):
        """Offer frames of pressures (T, N) in kPa."""
        for each in pressure + self.random.normal(0, self.noise_kpa, pressure.shape):
            self.sequence += 1
            t = self.sequence / RATE_HZ
            counts = np.round(NO_LOAD + each / self.gain).astype(np.uint16)
            flags = np.zeros(counts.shape, np.uint8)
            self.sensor.offer(RawFrame(self.sequence, t, 0.0, counts, flags, Loss(), arrived=t))

    def level(self, kpa, frames=40):
        """Bear the same pressure everywhere."""
        self.offer(np.full((frames, self.gain.size), float(kpa)))

    def press(self, count):
        """Be pressed with a tip at as many places, 300 kPa at the highest taxel."""
        for place in self.world.places(count, self.random):
            self.offer(3 * LOAD[:, None] * self.world.tip(TIP_MM / 2, place))

    def lay(self, count):
        """Have an edge laid across at as many slants, 60 kPa beside it."""
        for number in range(count):
            angle = np.pi / 2 * (number % 4) + np.radians(self.random.uniform(8, 35))
            self.offer(0.6 * LOAD[:, None] * self.world.edge(angle, self.random.uniform(-1, 1)))
