"""Taxels that are unknown, or noisier than most: inferred from the others, and from what they read themselves."""

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import SATURATED, UNKNOWN
from tactiled.restore.modes import Floats, Image, Transform
from tactiled.restore.noise import IMPLAUSIBLE_KPA
from tactiled.restore.prior import Spectrum
from tactiled.restore.scene import Scene
from tactiled.restore.solvers import conjugate_gradients

MAX_ITERATIONS = 12  # of conjugate gradients: a lone dead taxel needs two or three
SPECTRUM = (0.04, 1.5, 1e4)  # corner (cycles a cell), power, level over the noise: it fills a frame first
MAX_COVARIANCE_TAXELS = 1024  # inferred ones of which the deviation knows: their matrix has 8 MB
ROUGHNESS_TAXELS = 1.0  # standard deviation of the Gaussian in which roughness is measured
MAX_ROUGHNESS = 1e4  # and its inverse the least


class Inpainter:
    """Gives a frame as if all its taxels were as noisy as most, by a Gaussian of the blur's own modes.

    With precision Q = U diag(1 / (h^2 S + sigma^2)) U', the mean of the taxels m that are unknown or noisy, given
    their own readings r and the others' y_k, solves (Q_mm + D) y_m = D r - Q_mk y_k; D is 0 of an unknown one,
    1 / (sigma_m^2 - sigma^2) of a noisy one. S is that of the frame as it is once a fixed S has filled it. It is
    the same everywhere, but pressure is rough at edges and smooth between: D counts more where it is rough.
    """

    def __init__(self, scene: Scene) -> None:
        modes, self._scene = scene.modes, scene
        q0, p, level = SPECTRUM
        self._first = Spectrum(level, (1 + (modes.frequency / q0) ** 2) ** -p, q0, p)
        self._precisions: dict[Spectrum, Image] = {}
        cells = ROUGHNESS_TAXELS * scene.blur.surface_shape[0] / scene.blur.frame_shape[0]
        self._low_pass = np.exp(-2 * (np.pi * cells * modes.frequency[modes.head]) ** 2).astype(np.float32)
        self._analyse, self._synthesise = modes.to_taxel_modes(), modes.to_taxels()
        self._diagonal = Transform(tuple(basis**2 for basis in modes.taxel))  # of U diag(values) U'
        self._modes, self._product = self._analyse.empty(), self._synthesise.empty()
        self._frame, self._reading = self._synthesise.empty(), self._synthesise.empty()
        self._unknown, self._bounded, self._missing = np.zeros((3, *self._frame.shape), bool)
        self._spectrum = self._first  # S by which the last frame was filled

    def weigh(self, noise_ratio: Floats | None) -> None:
        """Take each taxel's noise over that of most, 1 of those (N,); None: all have the same."""
        shape = self._frame.shape
        ratio = np.ones(shape) if noise_ratio is None else np.reshape(noise_ratio, shape)
        self._noisy, self._scale = ratio > 1, np.asarray(1 / ratio, np.float32)
        self.weighs = bool(self._noisy.any())
        self._own = np.asarray(1 / np.where(self._noisy, ratio**2 - 1, 1), np.float32)  # D

    def mask(self, frame: NDArray[np.float32], flags: NDArray[np.uint8] | None) -> Image:
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

    def fill(self) -> Image:
        """Give the frame just masked, unknown and noisy taxels inferred, saturated ones not below their values."""
        lost = self._unknown | self._bounded
        self._frame[...] = self._reading
        self._missing[...] = (lost | self._noisy) & (not lost.all())
        self._weight = np.where(lost, np.float32(0), self._own)[self._missing]
        self._infer(self._first, self._weight)
        self._spectrum = self._scene.prior.pick(self._analyse(self._frame, self._modes))
        self._infer(self._spectrum, self._weight)
        if self.weighs:
            self._infer(self._spectrum, self._weight * self._roughness()[self._missing])
        self._frame[self._bounded] = np.maximum(self._frame, self._reading)[self._bounded]
        return self._frame

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell due to the taxels that `fill` inferred, by the linear filter."""
        missing, modes, values = self._missing, self._scene.modes, self._precision(self._spectrum)
        variance, synthesise = np.zeros(self._scene.blur.surface_shape), modes.head_to_surface()
        if np.count_nonzero(missing) > MAX_COVARIANCE_TAXELS:
            return variance
        bases = [basis[taxels] for basis, taxels in zip(modes.taxel, np.nonzero(missing), strict=True)]
        patterns = bases[0] if len(bases) == 1 else bases[0][:, :, None] * bases[1][:, None, :]
        flat = patterns.reshape(len(patterns), modes.gain.size)
        rough = np.sqrt(self._roughness()[missing].astype(float))
        Q = (flat * values.ravel()) @ flat.T / np.outer(rough, rough)
        errors = np.linalg.cholesky(np.linalg.inv(Q + np.diag(self._weight))).T @ flat
        weight = modes.gain * self._spectrum.ratio[modes.head] * values
        for error in errors.reshape(patterns.shape):
            variance += synthesise(np.asarray(weight * error, np.float32), synthesise.empty()) ** 2
        return np.asarray(self._scene.noise * np.sqrt(variance))

    def _infer(self, spectrum: Spectrum, D: Image) -> None:
        missing, Q = self._missing, self._precision(spectrum)
        self._frame[missing] = 0
        right = D * self._reading[missing] - self._apply(Q, self._frame)[missing]

        def system(v: Image) -> Image:
            spread = np.zeros(self._frame.shape, np.float32)
            spread[missing] = v
            return np.asarray(self._apply(Q, spread)[missing] + D * v)

        self._frame[missing] = conjugate_gradients(system, right, MAX_ITERATIONS)

    def _roughness(self) -> Image:
        """Mean square by which others mispredict the taxels around each (taxels' shape), over what it is by S.

        Taxel i differs by (Q y)_i / Q_ii from what all others say of it, which has the variance sigma^2 / Q_ii.
        """
        Q, sound = self._precision(self._spectrum), ~self._missing
        standard = self._apply(Q, self._frame) / np.float32(self._scene.noise)
        measured = self._apply(self._low_pass, sound * standard**2).copy()
        expected = self._apply(self._low_pass, sound * self._diagonal(Q, self._diagonal.empty()))
        ratio = measured / np.maximum(expected, np.finfo(np.float32).tiny)
        return np.asarray(np.clip(ratio, 1 / MAX_ROUGHNESS, MAX_ROUGHNESS))

    def _precision(self, spectrum: Spectrum) -> Image:
        """1 / (h^2 S + 1) of every taxel mode: the eigenvalues of Q times the noise's variance."""
        if spectrum not in self._precisions:
            scene, S = self._scene, spectrum.ratio[self._scene.modes.head]
            variance = scene.modes.gain**2 * S + 1 + scene.gain_variance * S
            self._precisions[spectrum] = np.asarray(1 / variance, np.float32)
        return self._precisions[spectrum]

    def _apply(self, values: Image, y: Image) -> Image:
        """U diag(values) U' y, valid until the next call."""
        self._analyse(y, self._modes)
        np.multiply(self._modes, values, out=self._modes)
        return self._synthesise(self._modes, self._product)
