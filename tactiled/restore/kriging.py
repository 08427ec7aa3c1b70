"""From an array's frame to that of a full grid on the surface over it and beyond its border, by kriging.

The cover goes on beyond the taxels, and so does what presses on it: a model that ends with them would squeeze that
into the last row. So the surface is a raster of square cells that reaches beyond the border, with a taxel on every
cell to the model, and each frame is completed to the one that these would read, by Gaussian process regression. A
frame y of taxels that feel A x of the pressure x, with x of covariance V S V' and white noise, is completed to

    f = U (h^2 S + 1) r (a' S a + 1)^-1 y,    a = V' A',    r = h a / (h^2 + FIRM):

the frame whose linear image, V S h / (h^2 S + 1) U' f, is the mean of the pressure given y. Where the taxels are
some of the grid's own, f is y on these, and on the others what these say of them. All is in units of the noise.
"""

from dataclasses import replace
from math import log
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32, Mask
from tactiled.core import surface
from tactiled.restore.blur import Blur
from tactiled.restore.modes import Modes, Transform
from tactiled.restore.pressed import Box
from tactiled.restore.prior import Kept, Spectrum, kept

FEW_VALUES = 1 << 19  # of a matrix: a larger one takes 20 ms and more, so spectra of near levels share it
LEVEL_STEP = 64.0  # between the levels of these
MAX_COVARIANCE_TAXELS = 1024  # inferred ones of which the deviation knows: their matrix has 8 MB
ROUGHNESS_TAXELS = 1.0  # standard deviation of the Gaussian that `smooth` weighs with
FIRM = 1e-6  # of gain squared: modes that keep less than a thousandth are not asked of the taxels


class Kriging(Protocol):
    """What completes frames of an array, as its taxels are some of the full grid's or lie anywhere."""

    bases: tuple[Floats, ...]  # orthonormal, along each axis of the array's frames: how rough they are

    def __call__(self, y: Floats32, spectrum: Spectrum, box: Box | None = None) -> Floats32:
        """Give the full frame; `y` is one of the array, without gaps. Valid until the next.

        What lies beyond a `box` that everything that presses is in may be taken to read zero.
        """

    def variances(self, ratios: Floats) -> Floats:
        """Give the variance of a frame's coefficients in `bases`, noise included, by each of many S (K, R, C)."""

    def amplifications(self, ratios: Floats) -> Floats:
        """Give the most by which the linear image amplifies what taxels feel, by each of many S (K, R, C)."""

    def precise(self, y: Floats32, spectrum: Spectrum) -> Floats32:
        """Give what is left of each taxel's reading that the others do not say, over its variance: C^-1 y."""

    def rows(self, where: Mask, spectrum: Spectrum) -> Floats32:
        """Give the rows (m, N) of C^-1 of some taxels, `where` they are in the frame."""

    def precision(self, spectrum: Spectrum) -> Floats:
        """Give the diagonal of C^-1, of the frame's shape."""

    def smooth(self, y: Floats32) -> Floats32:
        """Give a mean of what is around each taxel."""

    def unfelt(self, spectrum: Spectrum, gaps: "Gaps | None" = None) -> Floats:
        """Give the variance of every cell of the linear image that a full frame would not leave."""


class Gaps(NamedTuple):
    """Taxels of a frame whose readings are inferred."""

    where: NDArray[np.bool_]  # the frame's shape
    own: Floats  # (m,) precision that their own readings add, 0 for none
    rough: Floats  # the frame's shape: variance of what others do not say of a taxel, over what it is by S


class Part(Kriging):
    """Completes frames of a grid whose taxels are those of the full grid but for its border.

    With precision Q = U diag(1 / v) U', the mean of the taxels m that are not there, given the others k, is
    -Q_mm^-1 Q_mk y_k.
    """

    def __init__(self, blur: Blur, modes: Modes, gain_variance: Floats) -> None:
        """`modes` are the full grid's; `gain_variance` of their gains, as the cover's model may be wrong."""
        self._modes, self._gain_variance = modes, gain_variance
        shape = tuple(len(basis) for basis in modes.taxel)
        self._own = blur.wide.own if blur.wide else tuple(slice(n) for n in shape)
        self._there = np.zeros(shape, bool)
        self._there[self._own] = True
        self._missing, self._known = np.flatnonzero(~self._there), np.flatnonzero(self._there)
        self._frame: Floats32 = np.zeros(shape, np.float32)
        self._around: Floats32 = np.zeros(shape, np.float32)
        self._inside = self._frame[self._own]
        self._beyond, self._whole = np.divmod(self._missing, shape[-1]), (0, shape[0], 0, shape[-1])
        arrays = self._there, modes.gain, *modes.taxel, modes.frequency, gain_variance
        self._matrices: Kept[tuple[Floats32, Floats]] = kept("part", *arrays)
        self._of_taxels: Kept[Floats32] = kept("rows", *arrays)
        whole = not len(self._missing)
        sides = zip(modes.taxel, blur.frame_shape, strict=True)
        self.bases = tuple(U if whole else _cosines(n) for U, n in sides)
        parts = zip(self.bases, modes.taxel, self._own, strict=True)
        self._shares = [(basis.T @ U[own]) ** 2 for basis, U, own in parts]
        self._analyse, self._synthesise = modes.to_taxel_modes(), modes.to_taxels()
        self._coefficients, self._product = self._analyse.empty(), self._synthesise.empty()
        self._squares = Transform(tuple(basis**2 for basis in modes.taxel))
        waves = modes.frequency[modes.head] * ROUGHNESS_TAXELS * blur.surface_shape[0] / blur.frame_shape[0]
        self._low_pass = np.asarray(np.exp(-2 * (np.pi * waves) ** 2), np.float32)

    def __call__(self, y: Floats32, spectrum: Spectrum, box: Box | None = None) -> Floats32:
        """Give the full frame; `y` is one of the array, without gaps. Valid until the next."""
        if not len(self._missing):
            return y
        if box and box[4]:
            self._frame.fill(0)
            np.copyto(self._inside, y)
        else:
            (matrix, _), (rows, columns) = self._matrix(self._shared(spectrum)), self._own
            at = rows.start, columns.start
            surface.complete(matrix, y, *self._beyond, *at, box[:4] if box else self._whole, self._frame)
        return self._frame

    def variances(self, ratios: Floats) -> Floats:
        """Give the variance of a frame's coefficients in `bases`, noise included, by each of many S (K, R, C)."""
        return np.asarray(self._shares[0] @ self._variance(ratios) @ self._shares[1].T)

    def amplifications(self, ratios: Floats) -> Floats:
        """Give the most by which the linear image amplifies what taxels feel, by each of many S (K, R, C)."""
        S = ratios[self._modes.head]
        return np.asarray((self._modes.gain * S / self._variance(ratios)).max(axis=(1, 2)))

    def precise(self, y: Floats32, spectrum: Spectrum) -> Floats32:
        """Give C^-1 y."""
        spectrum = self._shared(spectrum)
        return self._apply(np.asarray(1 / self._variance(spectrum.ratio), np.float32), self(y, spectrum))

    def rows(self, where: Mask, spectrum: Spectrum) -> Floats32:
        """Give the rows (m, N) of C^-1 of some taxels, `where` they are in the frame."""
        spectrum = self._shared(spectrum)

        def make() -> Floats32:
            taxels = np.zeros(self._there.shape, bool)
            taxels[self._own] = where
            Q = self._rows(taxels, spectrum)
            rows = Q[:, self._known]
            if len(self._missing):
                rows += Q[:, self._missing].astype(np.float32) @ self._matrix(spectrum)[0]
            kept = np.asarray(rows, np.float32)
            kept.flags.writeable = False
            return kept

        return self._of_taxels(spectrum, make, int(np.count_nonzero(where)) * where.size, where.tobytes())

    def precision(self, spectrum: Spectrum) -> Floats:
        """Give the diagonal of C^-1, of the frame's shape."""
        spectrum = self._shared(spectrum)
        values = np.asarray(1 / self._variance(spectrum.ratio), np.float32)
        diagonal = self._squares(values, self._squares.empty())[self._own].astype(float)
        if len(self._missing):
            diagonal += self._matrix(spectrum)[1].reshape(diagonal.shape)
        return np.asarray(diagonal)

    def smooth(self, y: Floats32) -> Floats32:
        """Give a mean of what is around each taxel."""
        self._around[self._own] = y
        return self._apply(self._low_pass, self._around)

    def unfelt(self, spectrum: Spectrum, gaps: Gaps | None = None) -> Floats:
        """Give the variance of every cell of the linear image that a full frame would not leave."""
        modes, lost, extra = self._modes, ~self._there, np.zeros(self._there.shape)
        rough = np.ones(lost.shape)
        if gaps:
            lost[self._own], rough[self._own] = gaps.where, gaps.rough
            extra[self._own][gaps.where] = gaps.own
        variance = np.zeros(tuple(len(basis) for basis in modes.surface))
        if not lost.any() or np.count_nonzero(lost) > MAX_COVARIANCE_TAXELS:
            return variance
        rows, precision = _patterns(modes, lost), 1 / self._variance(spectrum.ratio)
        scale = np.sqrt(rough[lost])
        Q = (rows * precision.ravel()) @ rows.T / np.outer(scale, scale)
        errors = np.linalg.cholesky(np.linalg.inv(Q + np.diag(extra[lost]))).T @ rows
        weight, synthesise = modes.gain * spectrum.ratio[modes.head] * precision, modes.head_to_surface()
        for error in errors.reshape(-1, *weight.shape):
            variance += synthesise(np.asarray(weight * error, np.float32), synthesise.empty()) ** 2
        return variance

    def _apply(self, values: Floats32, frame: Floats32) -> Floats32:
        """The array's own part of U diag(values) U' of a full frame, valid until the next call."""
        self._analyse(frame, self._coefficients)
        np.multiply(self._coefficients, values, out=self._coefficients)
        return self._synthesise(self._coefficients, self._product)[self._own]

    def _variance(self, ratio: Floats) -> Floats:
        """Variance v of every taxel mode by S (..., R, C): h^2 S + 1, and what the model's error adds."""
        S = ratio[self._modes.head]
        return np.asarray(self._modes.gain**2 * S + 1 + self._gain_variance * S)

    def _shared(self, spectrum: Spectrum) -> Spectrum:
        """Give the one by whose matrix a spectrum's frames are completed: itself where that is made in no time."""
        if len(self._missing) * len(self._known) <= FEW_VALUES:
            return spectrum
        return replace(spectrum, level=LEVEL_STEP ** round(log(spectrum.level, LEVEL_STEP)))

    def _matrix(self, spectrum: Spectrum) -> tuple[Floats32, Floats]:
        """-Q_mm^-1 Q_mk of a spectrum, and by how much Q_kk's diagonal is lower as the others are not there."""

        def make() -> tuple[Floats32, Floats]:
            Q = self._rows(~self._there, spectrum)
            matrix = np.asarray(-np.linalg.solve(Q[:, self._missing], Q[:, self._known]), np.float32)
            return matrix, np.einsum("mk,mk->k", matrix, Q[:, self._known])

        return self._matrices(spectrum, make, len(self._missing) * len(self._known))

    def _rows(self, taxels: Mask, spectrum: Spectrum) -> Floats:
        """Rows (m, R C) of Q of some taxels of the full grid."""
        U, V = self._modes.taxel
        patterns = _patterns(self._modes, taxels) / self._variance(spectrum.ratio).ravel()
        return np.asarray((U @ patterns.reshape(-1, *taxels.shape) @ V.T).reshape(len(patterns), -1))


class Anywhere(Kriging):
    """Completes frames of few taxels that lie anywhere on the surface, or are wider than its cells."""

    def __init__(self, blur: Blur, modes: Modes, gain_variance: Floats) -> None:
        """`modes` are the full grid's; `gain_variance` of their gains, as the cover's model may be wrong."""
        assert blur.wide is not None
        assert blur.wide.felt is not None
        felt, self._modes = blur.wide.felt, modes
        self._gain_variance = gain_variance.ravel()
        h, (U, V) = modes.gain.ravel(), modes.surface
        self._a = (U.T @ felt.reshape(-1, len(U), len(V)) @ V).reshape(len(felt), -1)  # (N, R C)
        self._r = self._a * (h / (h**2 + FIRM))
        self._shape, self._h = blur.frame_shape, h
        self._weights = np.abs(felt @ felt.T)
        self._weights = np.asarray(self._weights / self._weights.sum(axis=1, keepdims=True), np.float32)
        self._frame = np.empty([len(basis) for basis in modes.taxel], np.float32)
        self._flat = self._frame.reshape(-1)
        if len(self._shape) == 2:
            self.bases = tuple(_cosines(n) for n in self._shape)
            E = np.asarray(np.kron(*self.bases))
        else:
            E = np.asarray(np.linalg.svd(self._a)[0], float)
            self.bases = (E,)
        self._shares, self._noise_shares = (E.T @ self._a) ** 2, (E.T @ self._r) ** 2
        arrays = felt, modes.gain, *modes.taxel, *modes.surface, modes.frequency, gain_variance
        self._matrices: Kept[Floats32] = kept("frame", *arrays)
        self._inverses: Kept[Floats32] = kept("inverse", *arrays)

    def __call__(self, y: Floats32, spectrum: Spectrum, box: Box | None = None) -> Floats32:
        """Give the full frame; `y` is one of the array, without gaps. Valid until the next."""
        del box

        def make() -> Floats32:
            S, (U, V) = spectrum.ratio.ravel(), self._modes.taxel
            weighted = (self._inverse(spectrum) @ self._r) * ((self._h**2 + self._gain_variance) * S + 1)
            matrix = (U @ weighted.reshape(-1, *self._frame.shape) @ V.T).reshape(len(weighted), -1)
            return np.ascontiguousarray(matrix.T, np.float32)

        self._matrices(spectrum, make, self._flat.size * len(self._a)).dot(y.reshape(-1), self._flat)
        return self._frame

    def variances(self, ratios: Floats) -> Floats:
        """Give the variance of a frame's coefficients in `bases`, noise included, by each of many S (K, R, C)."""
        S = ratios.reshape(len(ratios), -1, 1)
        v = self._shares @ S + self._noise_shares @ (self._gain_variance[:, None] * S) + 1
        return np.asarray(v.reshape(-1, *self._shape))

    def amplifications(self, ratios: Floats) -> Floats:
        """Give the most by which the linear image amplifies what taxels feel, by each of many S (K, R, C)."""
        S = ratios.reshape(len(ratios), -1)
        return np.asarray((self._h * S / ((self._h**2 + self._gain_variance) * S + 1)).max(axis=1))

    def precise(self, y: Floats32, spectrum: Spectrum) -> Floats32:
        """Give C^-1 y."""
        return np.asarray((self._inverse(spectrum) @ y.reshape(-1)).reshape(y.shape), np.float32)

    def rows(self, where: Mask, spectrum: Spectrum) -> Floats32:
        """Give the rows (m, N) of C^-1 of some taxels, `where` they are in the frame."""
        return np.asarray(self._inverse(spectrum)[where.ravel()], np.float32)

    def precision(self, spectrum: Spectrum) -> Floats:
        """Give the diagonal of C^-1, of the frame's shape."""
        return np.asarray(self._inverse(spectrum).diagonal().reshape(self._shape), float)

    def smooth(self, y: Floats32) -> Floats32:
        """Give a mean of what is around each taxel."""
        return np.asarray((self._weights @ y.reshape(-1)).reshape(y.shape))

    def unfelt(self, spectrum: Spectrum, gaps: Gaps | None = None) -> Floats:
        """Give the variance of every cell of the linear image that a full frame would not leave."""
        S, inverse = spectrum.ratio.ravel(), self._inverse(spectrum).astype(float)
        (U, V), shape = self._modes.surface, self._modes.gain.shape

        def variance(factor: Floats) -> Floats:
            """Of what a factor (m, N) of the frames' covariance adds up to in the linear image."""
            parts = (factor @ (self._a * S)).reshape(-1, *shape)
            return np.asarray(((U @ parts @ V.T) ** 2).sum(axis=0))

        full = self._h**2 * S**2 / ((self._h**2 + self._gain_variance) * S + 1)
        unfelt = U**2 @ full.reshape(shape) @ (V**2).T - variance(np.linalg.cholesky(inverse).T)
        if gaps:
            lost, scale = gaps.where.ravel(), np.sqrt(gaps.rough[gaps.where])
            Q = inverse[np.ix_(lost, lost)] / np.outer(scale, scale) + np.diag(gaps.own)
            unfelt = np.maximum(unfelt, 0) + variance(np.linalg.cholesky(np.linalg.inv(Q)).T @ inverse[lost])
        return np.maximum(unfelt, 0)

    def _inverse(self, spectrum: Spectrum) -> NDArray[Any]:
        """C^-1 of the array's frames."""

        def make() -> Floats32:
            S = spectrum.ratio.ravel()
            C = (
                (self._a * S) @ self._a.T
                + (self._r * (self._gain_variance * S)) @ self._r.T
                + np.eye(len(self._a))
            )
            return np.asarray(np.linalg.inv(C), np.float32)

        return self._inverses(spectrum, make, len(self._a) ** 2)


def make(blur: Blur, modes: Modes, gain_variance: Floats) -> Kriging:
    """Make what completes frames of an array to those of the full grid that has these modes."""
    makes = Part if blur.wide is None or blur.wide.felt is None else Anywhere
    return makes(blur, modes, gain_variance)


def _patterns(modes: Modes, taxels: NDArray[np.bool_]) -> Floats:
    """What each mode is (m, R C) at some taxels of the full grid."""
    down, across = (basis[at] for basis, at in zip(modes.taxel, np.nonzero(taxels), strict=True))
    return np.asarray((down[:, :, None] * across[:, None, :]).reshape(len(down), -1))


def _cosines(n: int) -> Floats:
    """Give (n, n): waves of 0 to n - 1 half-periods along n taxels; a frame may be high on its border."""
    waves = np.cos(np.pi * np.outer(np.arange(n) + 0.5, np.arange(n)) / n)
    return np.asarray(waves / np.linalg.norm(waves, axis=0))
