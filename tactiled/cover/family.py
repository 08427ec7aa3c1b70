"""A cover as a family of one parameter: every layer over the sensing plane thicker or thinner by one factor."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from tactiled.cover import kernel, layered
from tactiled.cover.stack import Stack
from tactiled.errors import PhysicsError

Floats = NDArray[np.float64]

FACTORS = (0.25, 4.0)  # thinnest and thickest cover of a family, over the configured thickness
# The table is in q times the depth of the sensing plane: G depends almost on that alone, so that it changes slowly
# with the factor. Below the first product G is 1, past the last 0, within 1e-9 (e^-60 in a half-space).
PRODUCTS = (1e-6, 10.0)
PRODUCT_KNOTS = 449  # 64 a decade
FACTOR_KNOTS = 25  # with these the spline is within 1e-5 of the exact gain: tests/cover/test_family.py


class CoverFamily:
    """Gains of a stack whose layers over the sensing plane are scaled in thickness, all by one factor."""

    def __init__(self, configured: Stack) -> None:
        self.configured = configured
        product, factors = np.geomspace(*PRODUCTS, PRODUCT_KNOTS), np.geomspace(*FACTORS, FACTOR_KNOTS)
        stacks = [configured.thickened(factor) for factor in factors]
        gains = np.stack([layered.gain(each, product / each.depth) for each in stacks], axis=1)
        self._table = RectBivariateSpline(np.log(product), np.log(factors), gains)

    def gain(self, q: Floats | float, factor: Floats | float) -> Floats:
        """Give G at q (cycles/mm) under a cover `factor` times as thick; q and factor broadcast.

        PhysicsError for a factor outside FACTORS.
        """
        beyond = [each for each in np.atleast_1d(factor).ravel() if not FACTORS[0] <= each <= FACTORS[1]]
        if beyond:
            low, high = FACTORS
            raise PhysicsError(f"cover of {beyond[0]:g} times the configured thickness: give {low:g} to {high:g}")
        product = np.asarray(q * self.configured.depth * np.asarray(factor), float)
        place = np.log(np.clip(product, *PRODUCTS))
        return np.asarray(np.where(product > PRODUCTS[1], 0.0, self._table.ev(place, np.log(factor))))

    def kernel(self, factor: float) -> kernel.Kernel:
        """Solve the cover that is `factor` times as thick, exactly."""
        return kernel.solve(self.configured.thickened(factor), "layered")
