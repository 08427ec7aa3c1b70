"""A cover as a family of one parameter: every layer over the sensing plane thicker or thinner by one factor."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline

from tactiled.arrays import Floats
from tactiled.cover import kernel, layered
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError

FACTORS = (0.25, 4.0)  # thinnest and thickest cover of a family, over the configured thickness
# The table is in q times the depth of the sensing plane: G depends almost on that alone, so that it changes slowly
# with the factor. Below the first product G is 1, past the last 0, within 1e-9 (e^-60 in a half-space).
PRODUCTS = (1e-6, 10.0)
PRODUCT_KNOTS = 449  # 64 a decade
FACTOR_KNOTS = 25  # with these the spline is within 1e-5 of the exact gain: tests/cover/test_family.py
# The gain as Poisson's ratio moves, by as much either way, is a parabola through three tables.
POISSON_SHIFT, MAX_POISSON = 0.1, 0.4999


class CoverFamily:
    """Gains of a stack whose layers over the sensing plane are scaled in thickness, all by one factor."""

    def __init__(self, configured: Stack) -> None:
        self.configured = configured
        self._table = _tabulate(configured)

    def gain(self, q: Floats | float, factor: Floats | float, poisson: float = 0.0) -> Floats:
        """Give G at q (cycles/mm) under a cover `factor` times as thick, of a Poisson's ratio moved by `poisson`.

        q and factor broadcast. PhysicsError for a factor outside FACTORS.
        """
        beyond = [each for each in np.atleast_1d(factor).ravel() if not FACTORS[0] <= each <= FACTORS[1]]
        if beyond:
            low, high = FACTORS
            raise PhysicsError(f"cover of {beyond[0]:g} times the configured thickness: give {low:g} to {high:g}")
        product = np.asarray(q * self.configured.depth * np.asarray(factor), float)
        place, across = np.log(np.clip(product, *PRODUCTS)), np.log(factor)
        if poisson == 0:
            value = self._table.ev(place, across)
        else:
            shifts, tables = self._shifted
            at = np.clip(poisson, -POISSON_SHIFT, MAX_POISSON - self._poisson)
            weights = lagrange(at, shifts)
            value = sum(weight * table.ev(place, across) for weight, table in zip(weights, tables, strict=True))
        return np.asarray(np.where(product > PRODUCTS[1], 0.0, value))

    @property
    def _poisson(self) -> float:
        """Poisson's ratio of the least compressible layer over the sensing plane."""
        return max(each.poisson for each in self.configured.layers[: self.configured.sensing])

    @cached_property
    def _shifted(self) -> tuple[Floats, list[RectBivariateSpline]]:
        """Three shifts of Poisson's ratio, one of them 0, and their tables."""
        more = min(POISSON_SHIFT, MAX_POISSON - self._poisson)
        middle = 0.0 if more >= POISSON_SHIFT / 2 else -POISSON_SHIFT / 2
        shifts = np.array([-POISSON_SHIFT, middle, more if middle == 0 else 0.0])
        stacks = (shifted(self.configured, each) for each in shifts)
        return shifts, [
            self._table if shift == 0 else _tabulate(s) for shift, s in zip(shifts, stacks, strict=True)
        ]

    def kernel(self, factor: float) -> kernel.Kernel:
        """Solve the cover that is `factor` times as thick, exactly."""
        return kernel.solve(self.configured.thickened(factor), "layered")


def shifted(stack: Stack, poisson: float) -> Stack:
    """The stack with Poisson's ratio moved by `poisson` in all layers over the sensing plane, as far as it may."""

    def moved(layer: Layer) -> Layer:
        highest = max(MAX_POISSON, layer.poisson)
        return replace(layer, poisson=min(max(layer.poisson + poisson, 0.0), highest))

    return stack.with_cover(moved)


def lagrange(at: float, nodes: Floats) -> Floats:
    """Weights (n,) of values at `nodes` (n,) in the polynomial through them, at one place."""
    rest = [np.delete(nodes, each) for each in range(len(nodes))]
    return np.array([np.prod((at - some) / (node - some)) for node, some in zip(nodes, rest, strict=True)])


def _tabulate(stack: Stack) -> RectBivariateSpline:
    """The gain in the logarithms of q times depth and of the factor."""
    product, factors = np.geomspace(*PRODUCTS, PRODUCT_KNOTS), np.geomspace(*FACTORS, FACTOR_KNOTS)
    stacks = [stack.thickened(factor) for factor in factors]
    gains = np.stack([layered.gain(each, product / each.depth) for each in stacks], axis=1)
    return RectBivariateSpline(np.log(product), np.log(factors), gains)
