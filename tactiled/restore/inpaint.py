"""Taxels that are not known: filled with what the known ones say about them, never with a value of their own."""

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import BAD, DEAD, MISSING, SATURATED
from tactiled.restore.modes import Image, Modes
from tactiled.restore.noise import HUGE
from tactiled.restore.solvers import conjugate_gradients

UNKNOWN = MISSING | BAD | DEAD
ROUNDS = 12  # of conjugate gradients: a lone dead taxel needs two or three
SCENE = (0.04, 1.5, 1e4)  # corner (cycles a cell), power and level over the noise of the scene that fills gaps


class Gaps:
    """Fills a frame's unknown taxels with their mean given the known ones, by a Gaussian of the blur's own modes.

    With precision Q = U diag(1 / (h^2 S + sigma^2)) U', the mean of the unknown u given the known solves
    Q_uu y_u = -Q_uk y_k.
    """

    def __init__(self, modes: Modes) -> None:
        q0, p, level = SCENE
        S = level * (1 + (modes.frequency[modes.head] / q0) ** 2) ** -p
        self._precision = np.asarray(1 / (modes.gain**2 * S + 1), np.float32)
        self._there, self._back = modes.to_taxel_modes(), modes.to_taxels()
        self._modes, self._product = self._there.empty(), self._back.empty()
        self.frame = self._back.empty()
        self.unknown = np.zeros(self.frame.shape, bool)
        self.bounded = np.zeros(self.frame.shape, bool)

    def mask(self, frame: NDArray[np.float32], flags: NDArray[np.uint8] | None) -> Image:
        """Give the frame with its unknown taxels at 0, and note which they are."""
        np.abs(frame, out=self.frame)
        np.less(self.frame, HUGE, out=self.unknown)
        np.logical_not(self.unknown, out=self.unknown)
        self.bounded[...] = False
        if flags is not None:
            self.unknown |= (flags & UNKNOWN) != 0
            self.bounded |= ((flags & SATURATED) != 0) & ~self.unknown
        self.frame[...] = frame
        self.frame[self.unknown] = 0
        return self.frame

    def fill(self) -> Image:
        """Give the frame just masked, each unknown taxel inferred, a saturated one not below its value."""
        open_ = self.unknown | self.bounded
        if open_.all():
            return self.frame
        floor = self.frame[self.bounded]
        self._infer(open_)
        self.frame[self.bounded] = np.maximum(self.frame[self.bounded], floor)
        return self.frame

    def _infer(self, gap: NDArray[np.bool_]) -> None:
        self.frame[gap] = 0
        right = -self._apply(self.frame)[gap]

        def system(v: Image) -> Image:
            spread = np.zeros(self.frame.shape, np.float32)
            spread[gap] = v
            return self._apply(spread)[gap]

        self.frame[gap] = conjugate_gradients(system, right, ROUNDS)

    def _apply(self, y: Image) -> Image:
        self._there(y, self._modes)
        np.multiply(self._modes, self._precision, out=self._modes)
        return self._back(self._modes, self._product)
