"""Rate-independent hysteresis: what a taxel counts on the way up and on the way down, by two play operators.

Generalized Prandtl-Ishlinskii model (Al Janaideh, Rakheja, Su 2009), in its inverse form, as counts are known and
pressure is wanted: v = u + weight (P_near - P_far), and the curve takes v. A play P follows the relative counts u
between u - r and u + min(r, u): its branches close at no load, where it forgets what was before.
"""

from typing import NamedTuple

import numpy as np

from tactiled.arrays import Floats32, Reals
from tactiled.errors import ConfigError


class Loop(NamedTuple):
    """The hysteresis of all taxels of an array."""

    near: float  # half-width of the narrow play, relative counts: noise within it changes nothing
    far: float  # of the wide one
    weight: float  # under 1, so that v rises with u

    def check(self) -> None:
        """ConfigError, by name, for a loop that is none."""
        if not 0 <= self.near < self.far <= 1:
            raise ConfigError(
                f"loop: half-widths {self.near:g} and {self.far:g}: give 0 to 1, the first one lower"
            )
        if not 0 < self.weight < 1:
            raise ConfigError(f"loop: weight is {self.weight:g}: give a number between 0 and 1")

    @property
    def percent(self) -> float:
        """Its width, % of full scale in relative counts."""
        return 200 * self.weight * (self.far - self.near)


class Plays:
    """Play operators of some half-widths for each taxel of an array, from no load on."""

    def __init__(self, half_widths: Reals, end: Reals) -> None:
        """`half_widths` (J,) are relative to `end` (N,), the signed counts over no load at the range's end."""
        self._sign = np.sign(end).astype(np.float32)
        self._radius = np.multiply.outer(half_widths, np.abs(end)).astype(np.float32)
        self.state = np.zeros_like(self._radius)  # (J, N) counts, upwards under pressure

    def follow(self, over: Reals) -> Floats32:
        """Take counts over no load (N,), NaN: unknown, which changes nothing; the new state (J, N)."""
        up = self._sign * over
        above = np.minimum(self._radius, np.maximum(up, np.float32(0)))
        np.fmin(self.state, up + above, out=self.state)
        np.fmax(self.state, up - self._radius, out=self.state)
        return self.state


class LoopFollower:
    """What the hysteresis of one array adds to its counts, frame after frame."""

    def __init__(self, loop: Loop, end: Reals) -> None:
        self._plays = Plays(np.array([loop.near, loop.far]), end)
        self._factor = (loop.weight * np.sign(end)).astype(np.float32)
        self.added = np.zeros(end.size, np.float32)  # (N,) counts

    @property
    def state(self) -> Floats32:
        """All that it knows of the past, to go on from; a copy."""
        return self._plays.state.copy()

    def resume(self, state: Floats32) -> None:
        """Go on from a `state`."""
        self._plays.state[...] = state
        self._add()

    def follow(self, over: Reals) -> Floats32:
        """Take counts over no load (N,), NaN: unknown; what to add to them (N,)."""
        self._plays.follow(over)
        return self._add()

    def _add(self) -> Floats32:
        near, far = self._plays.state
        self.added = self._factor * (near - far)
        return self.added
