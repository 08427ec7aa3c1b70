"""Axisymmetric elements that do not lock: cubic displacement, quadratic discontinuous pressure (Q3-P2).

The pressure of an element is condensed into its stiffness. That leaves a symmetric positive definite system in the
displacements alone, as good at nu = 0.4999 as at 0.3, and lets pressure jump where the material does.
Depth z and displacement u_z point down; every integral is over r dr dz, the 2 pi left out.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded
from skfem import Basis, ElementH1, MeshQuad
from skfem.refdom import RefQuad

from tactiled.arrays import Floats, Ints
from tactiled.cover.line import DEGREE, lagrange
from tactiled.cover.stack import Stack
from tactiled.errors import PhysicsError

FIXED = -1  # the number of a displacement that is fixed at 0: the last one of an array with a 0 appended


NODES = np.array([(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1)])
SIZE = len(NODES)


class Tensor(ElementH1):  # type: ignore[misc]  # scikit-fem has no types
    """Lagrange's polynomials of DEGREE in r and in z; the mesh numbers their nodes, not scikit-fem."""

    refdom = RefQuad
    interior_dofs = SIZE
    maxdeg = 2 * DEGREE
    dofnames: ClassVar = ["u"] * SIZE

    def lbasis(self, X: Floats, i: int) -> tuple[Floats, Floats]:
        """Give the i-th polynomial and its gradient at X (2, ...)."""
        (along, d_along), (down, d_down) = (lagrange(node, x) for node, x in zip(NODES[i], X, strict=True))
        return along * down, np.stack([d_along * down, along * d_down])


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Corners of a mesh of quadrilaterals in r and z, whose layers begin at the rows `starts`."""

    r: Floats  # (columns + 1,) mm, from the axis outwards
    z: Floats  # (columns + 1, rows + 1) mm, from the surface downwards
    starts: tuple[int, ...]  # first row of elements of every layer, and the number of rows

    @property
    def shape(self) -> tuple[int, int]:
        """Elements along r and along z."""
        return len(self.r) - 1, self.z.shape[1] - 1

    @property
    def unknowns(self) -> int:
        """Displacements, those fixed at 0 included."""
        return 2 * (DEGREE * self.shape[0] + 1) * (DEGREE * self.shape[1] + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Elements:
    """Every element's stiffness and where its 2 n displacements stand in the system."""

    stiffness: Floats  # (elements, 2 n, 2 n), u_r of its n nodes, then u_z
    dofs: Ints  # (elements, 2 n), FIXED where it is fixed at 0
    row: Ints  # (elements,) along z
    lattice: Ints  # (elements, n, 2): each node's place on the lattice of all nodes
    size: int


def assemble(stack: Stack, mesh: Mesh) -> Elements:
    """Integrate the weak form, 2 mu eps(u):eps(v) + lambda P(div u) P(div v), element by element."""
    columns, rows = mesh.shape
    i, j = (corner.ravel() for corner in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    first = i * (rows + 1) + j
    corners = np.stack([first, first + rows + 1, first + rows + 2, first + 1])
    places = np.stack([np.repeat(mesh.r, rows + 1), mesh.z.ravel()])
    quads = MeshQuad(places, corners, sort_t=False, validate=False)
    basis = Basis(quads, Tensor(), intorder=2 * DEGREE + 1, disable_doflocs=True)
    nodes = DEGREE * np.stack([i, j], axis=-1)[:, None] + NODES
    layer = np.searchsorted(mesh.starts, j, side="right") - 1
    dofs, size = _number(stack, mesh, nodes, layer)
    return Elements(_stiffness(stack, basis, layer), dofs, j, nodes, size)


def _stiffness(stack: Stack, basis: Basis, layer: Ints) -> Floats:
    """Give the elements' stiffness (elements, 2 n, 2 n) for the layers they belong to."""
    mu, lam = (np.array([getattr(part, name) for part in stack.layers])[layer] for name in ("shear", "lame"))
    radius = basis.global_coordinates()[0]
    weight = (basis.dx * np.asarray(radius))[:, :, None]
    value = np.stack([np.asarray(field[0]) for field in basis.basis], axis=-1)
    d_r, d_z = np.moveaxis(np.stack([field[0].grad for field in basis.basis], axis=-1), 0, 0)
    none = np.zeros_like(d_r)
    hoop = np.broadcast_to(value, d_r.shape) / np.asarray(radius)[:, :, None]
    strain = np.stack(
        [
            np.concatenate([d_r, none], axis=-1),
            np.concatenate([none, d_z], axis=-1),
            np.concatenate([hoop, none], axis=-1),
            np.concatenate([d_z, d_r], axis=-1) / np.sqrt(2),
        ]
    )
    shape = (len(layer), -1, 2 * SIZE)
    x, y = basis.X - 0.5
    scaled = np.moveaxis(strain * np.sqrt(2 * weight), 0, 1).reshape(shape)
    divergence = strain[:3].sum(axis=0)
    linear = np.stack([x**a * y**b for a in range(DEGREE) for b in range(DEGREE - a)])
    mass = np.einsum("iq,eq,jq->eij", linear, weight[..., 0], linear)
    mean = (linear * weight.swapaxes(1, 2)) @ divergence
    shear = scaled.swapaxes(1, 2) @ scaled
    volume = mean.swapaxes(1, 2) @ np.linalg.solve(mass, mean)
    return np.asarray(mu[:, None, None] * shear + lam[:, None, None] * volume)


def _number(stack: Stack, mesh: Mesh, nodes: Ints, layer: Ints) -> tuple[Ints, int]:
    """Number displacements column by column: fixed ones -1, u_r twice where an interface has no friction."""
    columns, rows = mesh.shape
    lines = np.arange(DEGREE * rows + 1)
    slips = [DEGREE * start for start, bonded in zip(mesh.starts[1:-1], stack.bonds, strict=False) if not bonded]
    passed, reached = (np.searchsorted(slips, lines, side=side) for side in ("left", "right"))
    across = 2 * lines + 1 + reached
    free = np.ones((DEGREE * columns + 1, across[-1] + 1), bool)
    for side in (0, -1):
        free[side] = False
        free[side, across] = True
    free[:, across[-1]] = False
    free[:, across[-1] - 1] &= not stack.bonds[-1]
    number = np.where(free, free.cumsum().reshape(free.shape) - 1, FIXED)
    i, j = nodes[..., 0], nodes[..., 1]
    on_top = j == DEGREE * np.asarray(mesh.starts)[layer][:, None]
    along = 2 * j + np.where(on_top, reached[j], passed[j])
    return np.concatenate([number[i, along], number[i, across[j]]], axis=1), int(free.sum())


def solve(elements: Elements, load: Floats) -> Floats:
    """Give the displacements (size,) under nodal forces `load` (size,) by a banded Cholesky factorisation."""
    rows = np.repeat(elements.dofs[:, :, None], 2 * SIZE, axis=2)
    columns = rows.swapaxes(1, 2)
    keep = (columns >= rows) & (rows >= 0)
    offset = (columns - rows)[keep]
    width = int(offset.max()) + 1
    place = rows[keep] * width + offset
    bands = np.bincount(place, elements.stiffness[keep], minlength=width * elements.size)
    try:
        return solveh_banded(bands.reshape(elements.size, width).T, load, lower=True, check_finite=False)
    except LinAlgError as error:
        raise PhysicsError(
            "finite elements are singular in double precision: bring the layers' moduli closer together "
            "or Poisson's ratio further from 0.5"
        ) from error


def sensed(stack: Stack, mesh: Mesh, pressure: Floats) -> Floats:
    """Give the vertical nodal forces (DEGREE columns + 1,) on the sensing plane under those on the surface.

    They are the residual of the weak form above the plane, and converge at twice the rate of the stress itself.
    """
    elements = assemble(stack, mesh)
    i, j = np.moveaxis(elements.lattice, -1, 0)
    surface = j == 0
    load = np.zeros(elements.size)
    load[elements.dofs[:, SIZE:][surface]] = pressure[i[surface]]
    moved = np.append(solve(elements, load), 0.0)  # the last one for displacements that are FIXED
    above = elements.row == mesh.starts[stack.sensing] - 1
    residual = (elements.stiffness[above] @ moved[elements.dofs[above]][:, :, None])[:, SIZE:, 0]
    plane = j[above] == DEGREE * mesh.starts[stack.sensing]
    return np.asarray(np.bincount(i[above][plane], -residual[plane]), np.float64)
