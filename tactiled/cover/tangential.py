"""What taxels feel of a tangential load on the surface, and what it and pressure do to each other's stress."""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline

from tactiled.arrays import Floats
from tactiled.cover import layered
from tactiled.cover.kernel import frequencies
from tactiled.cover.operator import Way, fourier_sums
from tactiled.cover.stack import Stack
from tactiled.geometry import Array

PARTS = 4  # steps along a cell's side in which responses are tabulated
XX, YY, XY = (0, 0, 0), (0, 0, 1), (1, 1, 0)
APART_X, APART_Y, TILT_X, TILT_Y = (1, 0, 0), (0, 1, 0), (1, 0, 1), (0, 1, 1)


class Responses(NamedTuple):
    """Mean stress on N taxels for a unit load on each of M square cells; x comes before y."""

    tangential: Floats  # (2 N, 2 M) tangential stress under a tangential load
    apart: Floats  # (2 N, M) tangential stress under pressure
    tilt: Floats  # (N, 2 M) pressure under a tangential load


def responses(stack: Stack, array: Array, cells: Floats, side: float) -> Responses:
    """Solve flat layers for an array under square cells of `side` at `cells` (M, 2), all in mm.

    With along L, across A, apart D and tilt T of `layered.tangential`, and n the unit wave vector, waves t of
    tangential load and p of pressure, e^ik(x, y), leave the tangential stress (L n n' + A (1 - n n')) t - i D n p
    and add i T n't to the pressure. PhysicsError where a layer slides.
    """
    q = frequencies(stack)
    table = CubicSpline(np.log(q[1:]), layered.tangential(stack, q[1:]), axis=1)

    def gains(u: Floats, v: Floats) -> dict[Way, Floats]:
        length = np.hypot(u, v)
        n_x, n_y = (each / np.maximum(length, q[1]) for each in (u, v))
        found = table(np.log(np.clip(length, q[1], q[-1]))) * (length <= q[-1])
        along, across, apart, tilt = found
        more = along - across
        return {
            XX: across + more * n_x**2, YY: across + more * n_y**2, XY: -more * n_x * n_y,
            APART_X: apart * n_x, APART_Y: apart * n_y, TILT_X: -tilt * n_x, TILT_Y: -tilt * n_y,
        }  # fmt: skip

    offsets = array.positions[:, None] - np.asarray(cells, float)[None]
    away, sign = np.abs(offsets), np.where(offsets < 0, -1.0, 1.0)
    x, y = (np.arange(int(away[..., axis].max() * PARTS / side) + 5) * side / PARTS for axis in (0, 1))
    at = {
        way: RectBivariateSpline(y, x, sums).ev(away[..., 1], away[..., 0])
        * sign[..., 0] ** way[0]
        * sign[..., 1] ** way[1]
        for way, sums in fourier_sums(q, array, side, (x, y), gains).items()
    }
    return Responses(
        np.block([[at[XX], at[XY]], [at[XY], at[YY]]]),
        np.concatenate([at[APART_X], at[APART_Y]]),
        np.concatenate([at[TILT_X], at[TILT_Y]], axis=1),
    )
