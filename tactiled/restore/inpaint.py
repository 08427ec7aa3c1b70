"""Taxels that are unknown, or noisier than most: inferred from the others, and from what they read themselves."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from tactiled.arrays import Floats, Floats32
from tactiled.core import readings
from tactiled.frames import SATURATED, UNKNOWN
from tactiled.restore.kriging import Gaps
from tactiled.restore.noise import IMPLAUSIBLE_KPA
from tactiled.restore.prior import Spectrum
from tactiled.restore.scene import Scene
from tactiled.restore.solvers import conjugate_gradients

MAX_SOLVED = 1 << 17  # missing taxels times all: up to so many they are solved for at once, beyond by iterations
EXCESS = 0.5  # of a saturated taxel's reading: the standard deviation of what it would read without a ceiling
SWEEPS = 100  # over saturated taxels and what is inferred beside them, at most; 1000 have 1 % less error
MAX_PRODUCTS = 1 << 19  # of numbers in all sweeps: half a millisecond
MAX_ITERATIONS = 12  # of conjugate gradients
SPECTRUM = (0.04, 1.5, 1e4)  # corner (cycles a cell), power, level over the noise: it fills a frame first
MAX_ROUGHNESS = 1e4  # and its inverse the least


class Inpainter:
    """Gives a frame as if all its taxels were as noisy as most, by a Gaussian of the blur's own modes.

    With precision Q = U diag(1 / (h^2 S + sigma^2)) U', the mean of the taxels m that are unknown or noisy, given
    their own readings r and the others' y_k, solves (Q_mm + D) y_m = D r - Q_mk y_k; D is 0 of an unknown one,
    1 / (sigma_m^2 - sigma^2) of a noisy one. A saturated one would read about EXCESS r above its ceiling r, and no
    less than r: y_m is the mean of such values. S is that of the frame as it is once a fixed S has filled it. It
    is the same everywhere, but pressure is rough at edges and smooth between: D of a noisy taxel counts more where
    it is rough.
    """

    def __init__(self, scene: Scene) -> None:
        modes, self._scene = scene.modes, scene
        q0, p, level = SPECTRUM
        q0 /= scene.array.refine
        self._first = Spectrum(level, (1 + (modes.frequency / q0) ** 2) ** -p, q0, p)
        self._frame, self._reading = (np.empty(scene.array.frame_shape, np.float32) for _ in range(2))
        self._unknown, self._bounded, self._missing = np.zeros((3, *self._frame.shape), bool)
        self._spectrum = self._first  # S by which the last frame was filled

    def weigh(self, noise_ratio: Floats | None) -> None:
        """Take each taxel's noise over that of most, 1 of those (N,); None: all have the same."""
        shape = self._frame.shape
        ratio = np.ones(shape) if noise_ratio is None else np.reshape(noise_ratio, shape)
        self._noisy, self._scale = ratio > 1, np.asarray(1 / ratio, np.float32)
        self.weighs = bool(self._noisy.any())
        self._own = np.asarray(1 / np.where(self._noisy, ratio**2 - 1, 1), np.float32)  # D

    def mask(self, frame: NDArray[np.float32], flags: NDArray[np.uint8] | None) -> Floats32:
        """Give the frame, unknown taxels at 0, noisy ones scaled to the noise of most; note which are unknown."""
        self._unknown[...] = ~(np.abs(frame) < IMPLAUSIBLE_KPA)
        self._bounded[...] = False
        if flags is not None:
            self._unknown |= (flags & UNKNOWN) != 0
            self._bounded |= ((flags & SATURATED) != 0) & ~self._unknown
        self._reading[...] = frame
        self._reading[self._unknown] = 0
        return np.multiply(self._reading, self._scale, out=self._frame)

    def is_empty(self) -> bool:
        """Whether the frame just masked has no taxel that is known."""
        return bool(self._unknown.all())

    def fill(self) -> Floats32:
        """Give the frame just masked, unknown and noisy taxels inferred, saturated ones not below their values."""
        lost = self._unknown | self._bounded
        self._frame[...] = self._reading
        self._missing[...] = lost | self._noisy
        own = np.where(lost, np.float32(0), self._own)
        if self._bounded.any():
            excess = np.maximum(EXCESS * np.abs(self._reading), self._scene.noise) / self._scene.noise
            own = np.where(self._bounded, excess**-2, own)
        self._weight = np.asarray(own[self._missing], np.float32)
        self._infer(self._first, self._weight)
        self._spectrum = self._scene.prior.pick(self._frame)
        self._infer(self._spectrum, self._weight)
        if self.weighs:
            rough = np.where(self._bounded, 1, self._roughness())
            self._infer(self._spectrum, self._weight * rough[self._missing])
        self._frame[self._bounded] = np.maximum(self._frame, self._reading)[self._bounded]
        return self._frame

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell due to the taxels that `fill` inferred, by the linear filter."""
        own = np.where(self._bounded[self._missing], 0, self._weight).astype(float)
        gaps = Gaps(self._missing, own, self._roughness().astype(float))
        return self._scene.unfelt(self._spectrum, gaps)

    def _infer(self, spectrum: Spectrum, D: Floats32) -> None:
        missing, kriging = self._missing, self._scene.kriging
        self._frame[missing] = 0
        if 0 < len(D) * missing.size <= MAX_SOLVED:
            rows = kriging.rows(missing, spectrum)
            right = (D * self._reading[missing] - rows @ self._frame.ravel()).astype(float)
            precision = np.ascontiguousarray(rows[:, missing.ravel()], float) + np.diag(D)
            _, found, failed = lapack.dposv(precision, right)
            if not failed:
                if self._bounded.any():
                    bounds = np.where(self._bounded, self._reading, -np.inf)[missing].astype(float)
                    found = np.maximum(found, bounds)
                    sweeps = min(SWEEPS, MAX_PRODUCTS // len(D) ** 2)
                    readings.raise_above(precision, right, bounds, self._scene.noise, sweeps, found)
                self._frame[missing] = found
                return
        right = D * self._reading[missing] - kriging.precise(self._frame, spectrum)[missing]

        def system(v: Floats32) -> Floats32:
            spread = np.zeros(self._frame.shape, np.float32)
            spread[missing] = v
            return np.asarray(kriging.precise(spread, spectrum)[missing] + D * v)

        self._frame[missing] = conjugate_gradients(system, right, MAX_ITERATIONS)

    def _roughness(self) -> Floats32:
        """Mean square by which others mispredict the taxels around each (taxels' shape), over what it is by S.

        Taxel i differs by (Q y)_i / Q_ii from what all others say of it, which has the variance sigma^2 / Q_ii.
        """
        kriging, sound = self._scene.kriging, ~self._missing
        standard = kriging.precise(self._frame, self._spectrum) / np.float32(self._scene.noise)
        measured = kriging.smooth(sound * standard**2).copy()
        expected = kriging.smooth(np.asarray(sound * kriging.precision(self._spectrum), np.float32))
        ratio = measured / np.maximum(expected, np.finfo(np.float32).tiny)
        return np.asarray(np.clip(ratio, 1 / MAX_ROUGHNESS, MAX_ROUGHNESS))
