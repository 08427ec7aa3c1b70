"""The covers, loads and cells of Shimojo's paper, each solved by finite elements and exactly."""

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
from scipy.signal import fftconvolve
from scipy.special import spherical_jn

from tactiled.arrays import Floats
from tactiled.cover.kernel import Kernel, solve
from tactiled.cover.operator import matrix, stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import Array, grid

Model = Literal["layered", "fem"]
MODELS: tuple[Model, Model] = ("layered", "fem")  # exact, and by finite elements

SENSOR = Layer(thickness=1.0, young=980.0, poisson=0.3)
THICKNESSES = (0.1, 0.2, 0.4, 0.6)  # mm
MODULI = (98.0, 490.0, 980.0, 4903.0, 9807.0)  # MPa
RATIOS = (0.2, 0.3, 0.4, 0.45)

LOAD = 0.98  # N

ELEMENT = 0.05  # mm, side of the ring's elements
ELEMENTS = 40
CELL = 4.57  # mm, side of the experiment's pressure cells
SHEETS = (0.25, 0.5, 1.0)  # mm of rubber
ROD = 3.0  # mm, radius of the rod's tip
ROD_CONTACT = (3 * LOAD * ROD * (1 - 0.3**2) / (4 * 98.0)) ** (1 / 3)  # mm, radius on a deep cover (Hertz)
POINT = 0.02  # mm, side of the square that stands for a point load


@cache
def covered(model: Model, thickness: float = 0.2, young: float = 98.0, poisson: float = 0.3) -> Kernel:
    """The paper's sensor under a cover: thickness (mm), Young's modulus (MPa), Poisson's ratio."""
    return solve(Stack((Layer(thickness, young, poisson), SENSOR)), model)


def centres() -> Floats:
    """The places (40,) in mm of the elements' centres along one side."""
    return np.asarray((np.arange(ELEMENTS) - (ELEMENTS - 1) / 2) * ELEMENT, np.float64)


def ring() -> Floats:
    """The square ring (40, 40): 1 inside its outer side of 1.0 mm and outside its inner side of 0.6 mm."""
    along = np.abs(centres())
    reach = np.maximum(along[:, None], along)
    return np.asarray((reach < 0.5) & (reach > 0.3), float)


@cache
def under(kernel: Kernel) -> Floats:
    """The ring's pressure (40, 40) under a cover, element by element."""
    response = stencil(kernel, grid(ELEMENTS, ELEMENTS, ELEMENT))
    return np.asarray(fftconvolve(response, ring(), "valid"))


def cell_force(kernel: Kernel, x: Floats, contact: float) -> Floats:
    """The force (N) on a cell at 0 of LOAD on a square of side `contact` (mm) at x (n,) mm."""
    cell = Array(np.zeros((1, 2)), CELL, CELL)
    places = np.column_stack([x, np.zeros_like(x)])
    return np.asarray(matrix(kernel, cell, places, contact)[0] * LOAD / contact**2 * CELL**2)


def spread(kernel: Kernel, radius: float) -> Kernel:
    """What a cover makes of Hertz's pressure, sqrt(1 - r^2 / radius^2), in place of a point load."""
    x = 2 * np.pi * radius * np.maximum(kernel.q, 1e-12)
    return replace(kernel, gain=kernel.gain * 3 * spherical_jn(1, x) / x)
