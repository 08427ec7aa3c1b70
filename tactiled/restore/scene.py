"""One frame in the blur's modes: what every method starts from."""

from collections.abc import Callable
from math import prod, sqrt
from typing import NamedTuple

import numpy as np

from tactiled.restore.blur import Blur
from tactiled.restore.modes import Image
from tactiled.restore.prior import CORNERS, Prior

FORCE_BOUNDS = (0.5, 2.0)  # of the scale that restores the total force: outside it the force was not known anyway
AHEAD = 1024  # cells up to which there is room for what every spectrum needs
AGREED = 0.25  # standard deviations of the total force: a smaller difference is left alone
ANEW = 0.3  # of the frame's square: one that changed by more has little to do with the frame before
MOVED = 1.5  # times what noise alone may change
ROUGH = CORNERS[-2]  # cycles a cell: a spectrum that falls no sooner
SPOTS = 16.0  # taxels: a frame as rough whose pressure is on no more may be of points
SURE = 4.0  # standard deviations that a total force must stand out by to be held to


class Restored(NamedTuple):
    """A restored image and what is known about it."""

    image: Image  # kPa, the surface's shape; valid until the next call
    method: str  # what ran
    why: str  # why it was chosen
    iterations: int
    noise_gain: float  # restored noise over raw noise, root mean square over the cells
    resolution_mm: float  # the finest half-period that the image carries above its noise


class Scene:
    """Holds the newest frame's modes, the spectrum picked for it, and its force; allocates nothing a frame."""

    def __init__(self, blur: Blur, noise: float) -> None:
        self.blur, self.noise = blur, noise
        self.modes = blur.modes
        self.prior = Prior(self.modes, noise)
        self._there = self.modes.to_taxel_modes()
        self.c = self._there.empty()
        self.follows = False  # whether anyone starts from the frame before
        self._from = np.zeros_like(self.c)  # the modes of the last frame that moved
        self.step = np.zeros_like(self.c)  # what changed since
        self.moved = True  # whether that is more than noise does
        self.anew = True  # whether the frame before says nothing about this one
        self.flat, self._flat_step = self.c.reshape(-1), self.step.reshape(-1)
        self._restless = 2 * noise**2 * (self.c.size + SURE * sqrt(2 * self.c.size))  # what noise alone may change
        ones = np.ones(blur.frame_shape, np.float32)
        self.ones = self._there(ones, self._there.empty()).reshape(-1)
        felt = self.modes.to_surface_modes()
        of_modes = felt(blur.reach, felt.empty())
        self.felt = of_modes[self.modes.head].ravel()  # total force of each mode, by the blur
        noise_of_sum = noise * float(np.sqrt(ones.size))
        self._sure, self._agreed = SURE * noise_of_sum, AGREED * noise_of_sum
        self.power = self.prior.squares.reshape(-1)  # c squared
        self.number = 0  # of the spectrum in the prior
        self.high = self.low = 0.0  # kPa, the frame's largest and smallest
        self._resolution: dict[int, float] = {}
        self.widest_mm = blur.cell_mm * max(blur.surface_shape)

    def look(self, y: Image) -> None:
        """Take in a frame without gaps."""
        self._there(y, self.c)
        self.number = self.prior.pick(self.c)
        if self.follows:
            np.subtract(self.c, self._from, out=self.step)
            changed = float(self._flat_step.dot(self._flat_step))
            self.moved = changed > MOVED * self._restless
            self.anew = self.moved and changed > self._restless + ANEW * float(self.flat.dot(self.flat))
            if self.moved:
                np.copyto(self._from, self.c)

    @property
    def force(self) -> float:
        """Sum over the frame (kPa)."""
        return float(self.ones.dot(self.flat))

    def ahead(self, *prepare: Callable[[], None]) -> None:
        """Make what any spectrum needs now rather than in the frame that first shows it, where there is room."""
        if prod(self.blur.surface_shape) > AHEAD:
            return
        for number in range(len(self.prior)):
            self.number = number
            for each in prepare:
                each()
        self.empty()

    def empty(self) -> None:
        """Take in that there is nothing to see, without looking."""
        self.number = 0

    @property
    def spotted(self) -> bool:
        """Whether the frame is of a few small spots: no spectrum tells where in a cell they are."""
        square = float(self.flat.dot(self.flat))
        return self.prior.corner(self.number) >= ROUGH and self.force**2 < SPOTS * square

    def force_scale(self, missed: float) -> float:
        """What to multiply an image by whose blur's total misses `missed` of the frame's, so that it does not."""
        if -self._agreed < missed < self._agreed:
            return 1.0
        force = self.force
        predicted = force - missed
        if abs(force) < self._sure or predicted * force <= 0:
            return 1.0
        return min(max(force / predicted, FORCE_BOUNDS[0]), FORCE_BOUNDS[1])

    def resolution(self) -> float:
        """Half-period (mm) of the finest mode whose signal, by the spectrum picked, is above the noise."""
        if self.number not in self._resolution:
            clear = self.modes.gain**2 * self.prior.ratio(self.number)[self.modes.head] > 1
            finest = float(self.modes.frequency[self.modes.head][clear].max(initial=0.0))
            half_period = 0.5 * self.blur.cell_mm / finest if finest else self.widest_mm
            self._resolution[self.number] = min(self.widest_mm, half_period)
        return self._resolution[self.number]
