"""A tangential load for skins that feel it: made up, so that there is something to see."""

import numpy as np

from tactiled.arrays import Floats
from tactiled.simulate.array import Surface
from tactiled.simulate.scenes import Scene

FRICTION = 0.25  # load over pressure where what touches slides
SLOW_MM_S = 2.0  # speed at which it is half of that
STEP_S = 0.01  # over which motion is looked at


def traction(scene: Scene, surface: Surface, t: float) -> Floats:
    """Load (2, rows, columns) in kPa on the surface at `t` s, along x and y: as the pressure's middle moves."""
    now, before = (scene(surface.x, surface.y, at, surface.size, surface.grain) for at in (t, t - STEP_S))
    speed = (
        (_middle(now, surface) - _middle(before, surface)) / STEP_S if now.any() and before.any() else np.zeros(2)
    )
    friction = FRICTION * speed / (np.hypot(*speed) + SLOW_MM_S)
    return np.asarray(friction[:, None, None] * now)


def _middle(pressure: Floats, surface: Surface) -> Floats:
    """Centre (2,) of a pressure, mm."""
    return np.array([(pressure * each).sum() for each in (surface.x, surface.y)]) / float(pressure.sum())
