"""The exact gains of flat layers: plane strain, wavenumber by wavenumber, under pressure and tangential load.

In a layer the Airy stress is f(kz) cos(kx), k = 2 pi q, with f'''' - 2 f'' + f = 0. A layer's state
(sigma_zz, tau_xz, 2 k u_x, 2 k u_z) is linear in (f, f', f'', f'''), and four continuities an interface
determine the four constants of every layer.
"""

import numpy as np

from tactiled.arrays import Floats
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError

NORMAL, SHEAR, ALONG, ACROSS = range(4)  # the rows of a state
MAX_HEIGHT = 800.0  # over 1/k: e^-MAX_HEIGHT is 0 in double precision
MAX_ROUNDING = 1e-6  # error of a gain that passes for exact


def gain(stack: Stack, q: Floats | float) -> Floats:
    """Give G(q), the normal stress at the sensing plane for unit surface pressure; q in cycles/mm, any shape."""
    return _gain(stack, q, NORMAL, NORMAL)


def tangential(stack: Stack, q: Floats | float) -> Floats:
    """Give (4, ...): what a tangential load and pressure do to each other's stress; q in cycles/mm, any shape.

    Per unit of load: tangential stress along the wave vector under a load along it; the same across it, of which
    pressure knows nothing; tangential stress sin(kx) under pressure cos(kx), which drives rubber apart; pressure
    cos(kx) under a tangential load sin(kx). PhysicsError where a layer slides: nothing holds the load.
    """
    if not all(stack.bonds):
        raise PhysicsError("a layer slides on the next without friction: no tangential load passes through it")
    along, apart, tilt = (_gain(stack, q, *ways) for ways in ((SHEAR, SHEAR), (NORMAL, SHEAR), (SHEAR, NORMAL)))
    return np.stack([along, _across(stack, np.asarray(q, float)), apart, tilt])


def _across(stack: Stack, q: Floats) -> Floats:
    """Give the gain of tangential load across the wave vector, u'' = k^2 u, from the base up, layer by layer.

    Where a is a layer's mu k times the compliance under it, 1 / (cosh kh + a sinh kh) of the stress passes.
    """
    k = 2 * np.pi * q
    compliance, passed = np.zeros_like(k), np.ones_like(k)
    for number in range(len(stack.layers), 0, -1):
        layer = stack.layers[number - 1]
        stiffness, height = layer.shear * np.maximum(k, 1e-12), np.minimum(k * layer.thickness, MAX_HEIGHT)
        a = compliance * stiffness
        if number <= stack.sensing:
            decayed = np.exp(-height)
            passed = passed * 2 * decayed / (1 + decayed**2 + a * (1 - decayed**2))
        slope = np.tanh(height)
        compliance = (a + slope) / (a * slope + 1) / stiffness
    return passed


def _gain(stack: Stack, q: Floats | float, load: int, sensed: int) -> Floats:
    """Give the stress `sensed` at the sensing plane under a unit `load`, each NORMAL or SHEAR, at q."""
    q = np.asarray(q, dtype=np.float64)
    if not np.isfinite(q).all() or (q < 0).any():
        raise PhysicsError("spatial frequency q must be finite and not negative (cycles/mm)")
    result = np.full(q.size, float(load == sensed))
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows inside is refused by its rounding error
        k = 2 * np.pi * q.ravel()
        waves = k * stack.faces[-1] > 1e-9
        if waves.any():
            result[waves] = _solve(stack, k[waves], load, sensed)
    return result.reshape(q.shape)


def _solve(stack: Stack, k: Floats, loaded: int, felt: int) -> Floats:
    """Give the gain at wavenumbers k (n,) in 1/mm, none of them zero."""
    faces = [_faces(layer, k) for layer in stack.layers]
    system = _system(stack, faces)
    load = np.zeros((len(k), system.shape[-1], 1))
    load[:, loaded] = 1
    sensed = np.zeros_like(load)
    first = 4 * (stack.sensing - 1)
    sensed[:, first : first + 4, 0] = faces[stack.sensing - 1][1][:, felt]
    try:
        state = np.linalg.solve(system, load)
        dual = np.linalg.solve(np.swapaxes(system, 1, 2), sensed)
    except np.linalg.LinAlgError as error:
        raise PhysicsError(f"layers' system is singular in double precision: {_contrast(stack)}") from error
    rounding = np.finfo(float).eps * (np.abs(dual) * (np.abs(system) @ np.abs(state))).sum(axis=(1, 2))
    if not rounding.max() < MAX_ROUNDING:
        raise PhysicsError(f"layers' system is too near singular in double precision: {_contrast(stack)}")
    return np.asarray((sensed * state).sum(axis=(1, 2)))


def _contrast(stack: Stack) -> str:
    """Name what makes a system hard to solve."""
    young = [layer.young for layer in stack.layers]
    return f"Young's moduli from {min(young):g} to {max(young):g} MPa; bring them closer together"


def _system(stack: Stack, faces: list[tuple[Floats, Floats]]) -> Floats:
    """Assemble the continuities: (n, 4 layers, 4 layers), the first row the pressure on the surface."""
    count = len(stack.layers)
    system = np.zeros((len(faces[0][0]), 4 * count, 4 * count))
    system[:, :2, :4] = faces[0][0][:, [NORMAL, SHEAR]]
    for i, bonded in enumerate(stack.bonds):
        rows = slice(4 * i + 2, 4 * i + 6)
        above = faces[i][1]
        if i == count - 1:
            system[:, rows, 4 * i :] = above[:, [ALONG if bonded else SHEAR, ACROSS]]
            break
        below = faces[i + 1][0]
        softer = min(stack.layers[i].shear, stack.layers[i + 1].shear)
        scale = np.array([1, 1, softer, softer])[:, None]
        system[:, rows, 4 * i : 4 * i + 4] = above * scale
        system[:, rows, 4 * i + 4 : 4 * i + 8] = -below * scale
        if not bonded:
            system[:, 4 * i + 4, :] = 0
            system[:, 4 * i + 3, 4 * i + 4 : 4 * i + 8] = 0
            system[:, 4 * i + 4, 4 * i + 4 : 4 * i + 8] = below[:, SHEAR]
    return system


def _faces(layer: Layer, k: Floats) -> tuple[Floats, Floats]:
    """Give the states (n, 4, 4) of a layer's four solutions on its top and on its bottom face."""
    height = np.minimum(k * layer.thickness, MAX_HEIGHT)
    thin = (height < 1)[:, None, None]
    growing, decaying = _series(np.minimum(height, 1.0)), _exponentials(height)
    nu = layer.poisson
    law = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [-nu, 0, nu - 1, 0], [0, 2 - nu, 0, nu - 1]])
    law[ALONG:] /= layer.shear
    top, bottom = (law @ np.where(thin, a, b) for a, b in zip(growing, decaying, strict=True))
    return top, bottom


def _series(height: Floats) -> tuple[Floats, Floats]:
    """Give (f, f', f'', f''') at 0 and `height` <= 1 of the solutions that start as z^j / j!, times h^-j."""
    c, s, h = np.cosh(height), np.sinh(height), height
    values = [  # f of each solution; its derivatives follow from the next ones
        c - h * s / 2,
        (3 * s - h * c) / 2,
        h * s / 2,
        _third(h),
    ]
    f0, f1, f2, f3 = values
    bottom = np.array(
        [
            [f0, f1, f2, f3],
            [-f3, f0, f1 + 2 * f3, f2],
            [-f2, -f3, f0 + 2 * f2, f1 + 2 * f3],
            [-f1 - 2 * f3, -f2, 2 * f1 + 3 * f3, f0 + 2 * f2],
        ]
    )
    scale = h ** -np.arange(4.0)[:, None]
    top = np.broadcast_to(np.eye(4)[:, :, None], bottom.shape)
    return np.moveaxis(top * scale, -1, 0), np.moveaxis(bottom * scale, -1, 0)


def _third(h: Floats) -> Floats:
    """Give (h cosh h - sinh h) / 2 for h <= 1 by its series, free of cancellation."""
    total, term = np.zeros_like(h), h**3 / 6
    for n in range(1, 12):
        total += n * term
        term = term * h**2 / ((2 * n + 2) * (2 * n + 3))
    return total


def _exponentials(height: Floats) -> tuple[Floats, Floats]:
    """Give (f, f', f'', f''') at 0 and `height` of (1, z) e^-z and, from the bottom face, (1, z-h) e^(z-h)."""
    decayed = np.exp(-height)
    one, zero = np.ones_like(height), np.zeros_like(height)

    def falling(z: Floats, e: Floats) -> list[list[Floats]]:
        return [[e, z * e], [-e, (1 - z) * e], [e, (z - 2) * e], [-e, (3 - z) * e]]

    def rising(z: Floats, e: Floats) -> list[list[Floats]]:
        return [[e, z * e], [e, (1 + z) * e], [e, (2 + z) * e], [e, (3 + z) * e]]

    top = np.concatenate([falling(zero, one), rising(-height, decayed)], axis=1)
    bottom = np.concatenate([falling(height, decayed), rising(zero, one)], axis=1)
    return np.moveaxis(top, -1, 0), np.moveaxis(bottom, -1, 0)
