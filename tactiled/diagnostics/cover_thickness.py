"""The thickest cover that explains a frame which the configured one, being too thick, does not."""

import numpy as np

from tactiled.arrays import Reals
from tactiled.calibrate.cover.deblur import Convolution, Images, Precision, deblurred
from tactiled.cover.family import CoverFamily
from tactiled.diagnostics.checks import MODEL_ERROR
from tactiled.geometry import Array

FACTORS = np.geomspace(0.5, 1.0, 8)  # of the configured thickness, from thin to thick
ITERATIONS = 150  # a factor, from the pressure under the factor before
EXPLAINED = 1.0  # mean square of the residuals over the noise: a sound frame has 0.3 to 0.9
MISMATCH = 2.0  # the same: the configured cover does not explain a frame with more
THINNER = 0.85  # of the configured thickness, at most: one frame does not know it better
MAX_FAULTY = 3  # taxels, those that fit worst: with more of them left out, thin covers' small discs are explained


def fitting_thickness(frame: Reals, noise_kpa: float, family: CoverFamily, array: Array) -> float | None:
    """Thickness (mm) of the thickest cover that explains a grid's frame (kPa, NaN where unknown).

    None where the configured cover explains it, or does but for at most MAX_FAULTY taxels, or where no cover does:
    then taxels are faulty, or something else is wrong. A cover that is thicker than configured does not show: it
    leaves no misfit, and what is soft under the one is sharp under the other.
    """
    working = np.isfinite(frame)[None]
    y = (np.where(working, frame, 0) / noise_kpa).astype(np.float32)
    weight = np.where(working, 1 / (1 + (MODEL_ERROR * y) ** 2), 0).astype(np.float32)
    x = np.zeros((1, *Convolution(family, 1.0, array).cells), np.float32)
    misfits = []
    for factor in FACTORS:
        blur = Convolution(family, float(factor), array)
        x = deblurred(blur, y, Precision(weight), x, ITERATIONS)
        squares = weight * (blur.forward(x) - y) ** 2
        misfits.append(_misfit(squares, weight))
    if misfits[-1] < MISMATCH or misfits[0] > EXPLAINED:
        return None
    for _ in range(MAX_FAULTY):
        weight.flat[squares.argmax()] = 0
        x = deblurred(blur, y, Precision(weight), x, ITERATIONS)
        squares = weight * (blur.forward(x) - y) ** 2
        if _misfit(squares, weight) < MISMATCH:
            return None
    thickest = np.interp(EXPLAINED, misfits, np.log(FACTORS))
    return float(np.exp(thickest) * family.configured.depth) if thickest < np.log(THINNER) else None


def _misfit(squares: Images, weight: Images) -> float:
    """Mean square of the residuals over the noise."""
    return float(squares.sum() / np.count_nonzero(weight))
