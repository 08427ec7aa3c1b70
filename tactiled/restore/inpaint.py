"""Taxels that are not known: filled with what the known ones say about them, never with a value of their own."""

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import SATURATED, UNKNOWN
from tactiled.restore.modes import Image, Modes
from tactiled.restore.noise import IMPLAUSIBLE_KPA
from tactiled.restore.solvers import conjugate_gradients

MAX_ITERATIONS = 12  # of conjugate gradients: a lone dead taxel needs two or three
SPECTRUM = (0.04, 1.5, 1e4)  # corner (cycles a cell), power and level over the noise of the pressure that fills


class Inpainter:
    """Fills a frame's unknown taxels with their mean given the known ones, by a Gaussian of the blur's own modes.

    With precision Q = U diag(1 / (h^2 S + sigma^2)) U', the mean of the unknown u given the known solves
    Q_uu y_u = -Q_uk y_k.
    """

    def __init__(self, modes: Modes) -> None:
        q0, p, level = SPECTRUM
        S = level * (1 + (modes.frequency[modes.head] / q0) ** 2) ** -p
        self._precision = np.asarray(1 / (modes.gain**2 * S + 1), np.float32)
        self._analyse, self._synthesise = modes.to_taxel_modes(), modes.to_taxels()
        self._modes, self._product = self._analyse.empty(), self._synthesise.empty()
        self._frame = self._synthesise.empty()
        self._unknown, self._bounded = np.zeros((2, *self._frame.shape), bool)

    def mask(self, frame: NDArray[np.float32], flags: NDArray[np.uint8] | None) -> Image:
        """Give the frame with its unknown taxels at 0, and note which they are."""
        np.abs(frame, out=self._frame)
        np.less(self._frame, IMPLAUSIBLE_KPA, out=self._unknown)
        np.logical_not(self._unknown, out=self._unknown)
        self._bounded[...] = False
        if flags is not None:
            self._unknown |= (flags & UNKNOWN) != 0
            self._bounded |= ((flags & SATURATED) != 0) & ~self._unknown
        self._frame[...] = frame
        self._frame[self._unknown] = 0
        return self._frame

    def fill(self) -> Image:
        """Give the frame just masked, each unknown taxel inferred, a saturated one not below its value."""
        missing = self._unknown | self._bounded
        if not missing.all():
            floor = self._frame[self._bounded]
            self._infer(missing)
            self._frame[self._bounded] = np.maximum(self._frame[self._bounded], floor)
        return self._frame

    def _infer(self, missing: NDArray[np.bool_]) -> None:
        self._frame[missing] = 0
        right = -self._apply(self._frame)[missing]

        def system(v: Image) -> Image:
            spread = np.zeros(self._frame.shape, np.float32)
            spread[missing] = v
            return self._apply(spread)[missing]

        self._frame[missing] = conjugate_gradients(system, right, MAX_ITERATIONS)

    def _apply(self, y: Image) -> Image:
        self._analyse(y, self._modes)
        np.multiply(self._modes, self._precision, out=self._modes)
        return self._synthesise(self._modes, self._product)
