"""One frame in the blur's modes: what every method starts from."""

from collections.abc import Callable
from math import nan, prod, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.core import coefficients, readings
from tactiled.restore.blur import THICKNESS_ERROR, Blur
from tactiled.restore.kriging import Gaps, make
from tactiled.restore.pressed import Pressed
from tactiled.restore.prior import CORNERS, Kept, Prior, Spectrum, kept

FORCE_BOUNDS = (0.5, 2.0)  # of the scale that restores the total force: outside it the force was not known anyway
MAX_PREPARED_CELLS = 4096  # up to which what every spectrum needs is made beforehand: 3.4 kB a cell, all together
FORCE_AGREES_SIGMAS = 0.25  # standard deviations of the total force: a smaller difference is left alone
IMAGE_FORCE_ERROR = 0.03  # of an image's total before it is held to the frame's, standard deviation
FORCE_NOISE_SIGMAS = 3.0  # of the noise of the total force: a larger difference is none of it
FORCE_PASSES = 8  # of Newton's method, to take an excess of force from the pressed cells; three or four settle
FORCE_CLEAR_SIGMAS = 4.0  # standard deviations that a total force must stand out by to be held to
MIN_REACH = 1e-6  # of the most that taxels feel of a cell: of one with less nothing is known
SPOTS_CORNER = CORNERS[-2]  # cycles a cell: a spectrum that falls no sooner
SPOTS_TAXELS = 16.0  # a frame as rough whose pressure is on no more may be of points


def never() -> bool:
    """Whether time is over, where there is no end to it."""
    return False


class Restored(NamedTuple):
    """A restored image and what is known about it."""

    image: Floats32  # kPa, the surface's shape; valid until the next call
    method: str  # what ran
    why: str  # why it was chosen
    iterations: int
    noise_gain: float  # restored noise over raw noise, root mean square over the cells
    resolution_mm: float  # the finest half-period that the image carries above its noise
    cut_short: bool = False  # whether the time for it was over before the method was done


def pressed_noise_gain(image: Floats32, linear: float) -> float:
    """Give a non-negative image's noise over the frame's: `linear`, the filter's, and 0 where nothing presses."""
    return linear * (np.count_nonzero(image) / image.size) ** 0.5


class Scene:
    """Holds the newest frame's modes, the spectrum picked for it, and its force; allocates nothing a frame.

    Frames are the array's; `blur`, modes and images are those of the wide grid where its cover goes on.
    """

    def __init__(self, array: Blur, noise: float) -> None:
        blur = array.wide.blur if array.wide else array
        self.array, self.blur, self.noise = array, blur, noise
        self.modes = blur.modes
        # The filters' constants allow for the rest.
        self.thickness_error = array.thickness_error
        excess = max(array.thickness_error**2 - THICKNESS_ERROR**2, 0.0)
        self.gain_variance = self.modes.gain_variance(excess)  # of the cover's model, that filters are to count
        self.kriging = make(array, self.modes, self.gain_variance)
        kriging = self.kriging
        self.prior = Prior(self.modes, noise, kriging.bases, kriging.variances, kriging.amplifications)
        self._analyse = self.modes.to_taxel_modes()
        self.c = self._analyse.empty()
        self.flat = self.c.reshape(-1)
        self.expired: Callable[[], bool] = never  # whether the time for this frame's image is over
        self.cut_short = False  # whether that ended an iteration
        ones = np.zeros(blur.frame_shape, np.float32)
        ones[array.wide.own if array.wide else ...] = array.taxel >= 0 if array.wide else 1
        self.ones = self._analyse(ones, self._analyse.empty()).reshape(-1)
        analyse = self.modes.to_surface_modes()
        # How much of each cell's pressure the taxels feel.
        self.cell_reach = np.asarray(blur.adjoint(ones), np.float32)
        of_modes = analyse(self.cell_reach, analyse.empty())
        self.reach = of_modes[self.modes.head].ravel()  # total force of each mode, by the blur
        self.size = prod(array.frame_shape)  # taxels
        noise_of_sum = noise * float(ones.sum()) / sqrt(self.size)
        self._force_variance = noise_of_sum**2
        self._force_clear = FORCE_CLEAR_SIGMAS * noise_of_sum
        self._force_agrees = FORCE_AGREES_SIGMAS * noise_of_sum
        bounds = FORCE_NOISE_SIGMAS * noise_of_sum, self._force_agrees, self._force_clear
        self._force_bounds = *bounds, *FORCE_BOUNDS, FORCE_PASSES
        self.spectrum = self.prior.spectra[0]
        self._pressed = Pressed(array, noise)
        self.box = self._pressed.whole  # on the surface that what presses is in
        self.high = self.low = 0.0  # kPa, the frame's largest and smallest
        self.force = self.square = 0.0  # kPa, the sum over the frame; kPa^2, that of squares
        self._reach = self.cell_reach.reshape(-1)
        gains = self.modes.gain, self.modes.frequency, self.gain_variance
        self._resolution: Kept[float] = kept("resolution", *gains, np.array(blur.cell_mm))
        self._unfelt: dict[Spectrum, Floats32] = {}
        self.widest_mm = blur.cell_mm * max(blur.surface_shape)

    def cut(self) -> bool:
        """Whether to stop iterating because the time for the image is over."""
        self.cut_short = self.expired()
        return self.cut_short

    def measure_range(self, y: Floats32) -> None:
        """Take in a frame's largest and smallest pressure; NaN where any is."""
        self.low, self.high, known = readings.look(y.reshape(-1))
        if known < y.size:
            self.low = self.high = nan

    def look(self, y: Floats32) -> None:
        """Take in a frame without gaps."""
        self.y = y
        self.spectrum = self.prior.pick(y)
        self.box = self._pressed(y)
        self.frame = self.kriging(y, self.spectrum, self.box)
        left, right = self._analyse.left, self._analyse.right
        self.force, self.square = coefficients.analyse(left, self.frame, right, self.ones, self.c)

    def look_at_nothing(self) -> None:
        """Take in that there is no pressure."""
        self.spectrum = self.prior.spectra[0]

    def inside(self, image: NDArray[Any]) -> NDArray[Any]:
        """Give the array's own part of an image (R, C) of the surface."""
        return image if self.array.wide is None else image[self.array.wide.own]

    def raw(self) -> Floats32:
        """Give the frame itself as an image of the array."""
        return self.y.reshape(-1)[self.array.taxel]

    def unfelt(self, spectrum: Spectrum, gaps: Gaps | None = None) -> Floats:
        """Standard deviation (kPa) of every cell of the linear image due to what no taxel reads."""
        if gaps is not None:
            return np.asarray(self.noise * np.sqrt(self.kriging.unfelt(spectrum, gaps)))
        if spectrum not in self._unfelt:
            self._unfelt[spectrum] = np.asarray(np.sqrt(self.kriging.unfelt(spectrum)), np.float32)
        return self.noise * self._unfelt[spectrum].astype(float)

    def prepare(self, *make: Callable[[], object]) -> None:
        """Make what any spectrum needs now rather than in the frame that first shows it, where there is room."""
        if prod(self.blur.surface_shape) <= MAX_PREPARED_CELLS:
            for spectrum in self.prior.spectra:
                self.spectrum = spectrum
                for each in make:
                    each()
        self.look_at_nothing()

    @property
    def spotted(self) -> bool:
        """Whether the frame is of a few small spots: no spectrum tells where in a cell they are."""
        return self.spectrum.corner >= SPOTS_CORNER and self.force**2 < SPOTS_TAXELS * self.square

    def force_scale(self, missed: float) -> float:
        """What to multiply an image by whose blur's total misses `missed` of the frame's, so that it does not."""
        if -self._force_agrees < missed < self._force_agrees:
            return 1.0
        force = self.force
        predicted = force - missed
        if abs(force) < self._force_clear or predicted * force <= 0:
            return 1.0
        return min(max(force / predicted, FORCE_BOUNDS[0]), FORCE_BOUNDS[1])

    def keep_force(self, flat: Floats32) -> None:
        """Hold an image (M,) without negative values to the frame's total force, as far as that is known.

        All taxels' noise is in the frame's total: where few cells are pressed, the image knows its force better.
        An excess is taken from all pressed cells alike, as far as they go; what lacks force is scaled up.
        """
        own = (IMAGE_FORCE_ERROR * self.force) ** 2
        likely = self._force_variance / (own + self._force_variance)  # the frame's part of the difference
        readings.keep_total(flat, self._reach, self.force, likely, *self._force_bounds)

    def most(self, image: Floats32) -> Floats:
        """Give the most (kPa) that each cell can have: all of the force that the taxels feel of an image."""
        total = float(self._reach.dot(image.reshape(-1))) + self._force_clear
        return np.asarray(total / np.maximum(self.cell_reach, MIN_REACH * self.cell_reach.max()), float)

    def resolution(self) -> float:
        """Half-period (mm) of the finest mode whose signal, by the spectrum picked, is above the noise."""

        def find() -> float:
            S = self.spectrum.ratio[self.modes.head]
            clear = self.modes.gain**2 * S > 1 + self.gain_variance * S
            finest = float(self.modes.frequency[self.modes.head][clear].max(initial=0.0))
            half_period = 0.5 * self.blur.cell_mm / finest if finest else self.widest_mm
            return min(self.widest_mm, half_period)

        return self._resolution(self.spectrum, find)
