"""Cubic functions of r on a line of elements: loading it, recovering a stress from its forces, transforming it."""

import numpy as np
from scipy.linalg import solveh_banded
from scipy.special import j0, j1

from tactiled.arrays import Floats, Ints

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(8)
X = (_POINTS + 1) / 2
WAVES_PER_PIECE = 1.0  # that eight Gauss points integrate
DEGREE = 3  # quadratic elements are too stiff for a hard skin that bends over foam


def lagrange(node: int, x: Floats) -> tuple[Floats, Floats]:
    """Give the polynomial that is 1 at `node` / DEGREE and 0 at the other nodes, and its derivative, at x."""
    others = [other / DEGREE for other in range(DEGREE + 1) if other != node]
    polynomial = np.polynomial.Polynomial.fromroots(others)
    scale = polynomial(node / DEGREE)
    return np.asarray(polynomial(x) / scale), np.asarray(polynomial.deriv()(x) / scale)


SHAPES = np.stack([lagrange(node, X)[0] for node in range(DEGREE + 1)])  # (DEGREE + 1, 8)


def points(r: Floats) -> tuple[Floats, Floats]:
    """Give Gauss points (elements, 8) in mm between the corners r (mm), and their weights r dr (mm^2)."""
    width = np.diff(r)[:, None]
    place = r[:-1, None] + width * X
    return place, width * _WEIGHTS / 2 * place


def _of(r: Floats) -> Ints:
    """Give the nodes (elements, DEGREE + 1) of every element."""
    return DEGREE * np.arange(len(r) - 1)[:, None] + np.arange(DEGREE + 1)


def forces(r: Floats, density: Floats) -> Floats:
    """Give the nodal forces (DEGREE elements + 1,) of a pressure given at the Gauss points."""
    share = (points(r)[1] * density) @ SHAPES.T
    return np.asarray(np.bincount(_of(r).ravel(), share.ravel()), np.float64)


def recover(r: Floats, force: Floats) -> Floats:
    """Give the nodal stress (DEGREE elements + 1,) whose nodal forces are `force`: the inverse of `forces`."""
    mass = np.einsum("eq,iq,jq->eij", points(r)[1], SHAPES, SHAPES)
    bands = [
        np.bincount(
            _of(r)[:, : DEGREE + 1 - off].ravel(), np.diagonal(mass, off, 1, 2).ravel(), minlength=len(force)
        )
        for off in range(DEGREE + 1)
    ]
    return np.asarray(solveh_banded(np.array(bands), force, lower=True))


def between(r: Floats, value: Floats, at: Floats) -> Floats:
    """Give a nodal `value` at the places `at` (n,) in mm."""
    element = np.clip(np.searchsorted(r, at, side="right") - 1, 0, len(r) - 2)
    local = (at - r[element]) / np.diff(r)[element]
    nodal = value[_of(r)][element]
    return np.asarray(sum(nodal[:, node] * lagrange(node, local)[0] for node in range(DEGREE + 1)), np.float64)


def hankel(r: Floats, value: Floats, q: Floats) -> Floats:
    """Give 2 pi integral of value J0(2 pi q r) r dr for q (n,) in cycles/mm, growing, of a nodal `value`.

    Far out an element spans many waves; there it is cut into pieces of a wave each, octave by octave of q.
    """
    octaves = np.flatnonzero(np.diff(np.floor(np.log2(np.maximum(q, q[1]) / q[1])))) + 1
    return np.concatenate([_octave(r, value, part) for part in np.split(q, octaves)])


def _octave(r: Floats, value: Floats, q: Floats) -> Floats:
    """Give the Hankel transform at some q (n,) that one division of the elements serves."""
    width = np.diff(r)
    pieces = np.ceil(width * q[-1] / WAVES_PER_PIECE).astype(int) + 1
    element = np.repeat(np.arange(len(width)), pieces)
    piece = np.arange(len(element)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    local = (piece[:, None] + X) / pieces[element][:, None]
    place = r[element][:, None] + width[element][:, None] * local
    weight = place * (width / pieces)[element][:, None] * _WEIGHTS / 2
    nodal = value[_of(r)][element]
    density = sum(nodal[:, node, None] * lagrange(node, local)[0] for node in range(DEGREE + 1)) * weight
    return np.asarray(2 * np.pi * j0(2 * np.pi * q[:, None] * place.ravel()) @ density.ravel())


def standing(n: Ints) -> Floats:
    """Give the n-th positive zeros of J1, by McMahon's expansion and Newton's method."""
    b = (n + 0.25) * np.pi
    x = b - 3 / (8 * b)
    for _ in range(3):
        x = x - j1(x) / (j0(x) - j1(x) / x)
    return np.asarray(x)
