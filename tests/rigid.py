"""Frictionless contact of rigid flat tools with a stack: Galerkin's method on its exact normal compliance.

The pressure under a tip is a series of P_2n(s) / s, s = sqrt(1 - (r/a)^2), whose Hankel transforms are spherical
Bessel functions; under a ridge of T_2n(x/b) / sqrt(1 - (x/b)^2), whose transforms are Bessel functions.
"""

import numpy as np
from scipy.special import jv, spherical_jn

from tactiled.cover import layered

TERMS = 8
WAVES = np.concatenate([np.linspace(1e-3, 60, 6000), np.geomspace(60.01, 3000, 6000)])  # times the half-width


def compliance(stack, k):
    """How far the surface gives way (mm) under a wave of unit pressure (MPa) of wavenumber k (n,), 1/mm."""
    faces = [layered._faces(layer, k) for layer in stack.layers]
    system = layered._system(stack, faces)
    load = np.zeros((len(k), system.shape[-1], 1))
    load[:, 0] = 1
    state = np.linalg.solve(system, load)[:, :4, 0]
    return -np.einsum("ni,ni->n", faces[0][0][:, layered.ACROSS], state) / (2 * k)


def tip_transform(stack, radius):
    """Transform, 1 at q = 0, of the pressure under a rigid flat round tip."""
    terms = _contact(stack, radius, spherical_jn, WAVES)
    return lambda q: sum(c * spherical_jn(2 * n, 2 * np.pi * q * radius) for n, c in enumerate(terms))


def ridge_transform(stack, width):
    """Transform, 1 at q = 0, of the pressure under a rigid flat ridge."""
    terms = _contact(stack, width / 2, jv, np.ones_like(WAVES))
    return lambda q: sum(c * jv(2 * n, np.pi * q * width) for n, c in enumerate(terms))


def _contact(stack, half, wave, measure):
    """Factors (TERMS,) of the series whose displacement is the same all over the contact; the first is 1."""
    table = np.geomspace(1e-3, 400, 800) / stack.depth
    gives, k = compliance(stack, table), WAVES / half
    beyond = gives[-1] * table[-1] / k  # a half-space
    gives = np.where(k < table[-1], np.interp(k, table, gives), beyond)
    waves = np.array([wave(2 * n, WAVES) for n in range(TERMS)])
    even = np.zeros(TERMS)
    even[0] = 1
    terms = np.linalg.solve((waves * gives * measure * np.gradient(WAVES)) @ waves.T, even)
    return terms / terms[0]
