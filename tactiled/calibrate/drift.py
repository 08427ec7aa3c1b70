"""Drift of the taxels' zeros, followed only where nothing can lie on a taxel.

A taxel that reads zero, is quiet and lies beyond the cover's reach of every contact is free: its zero follows its
reading. The zeros of all others follow the common mode of the free ones alone, each as strongly as it did while it
was free itself, so that a load never becomes a zero. A load that comes slower than MAX_RATE cannot be told from
drift.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.blocks import BLOCK_FRAMES, Block
from tactiled.cover.kernel import Kernel
from tactiled.geometry import Array

# Parts of full scale. The claims (tests/calibrate/test_drift.py) are for drift of 5 % of full scale an hour.
MAX_RATE = 0.10 / 3600  # a second: no zero moves faster; a load that comes within 10 s loses 0.03 % of full scale
BAND = 0.002  # that a free taxel may read beyond its noise
FROZEN_RATE = 0.01 / 3600  # a second: what the common mode may miss of a loaded taxel's drift, 20 % of 5 % an hour
MAX_MISSED = 0.10  # that it may have missed in all
SENSITIVITY_STEP = 0.005  # of the common mode, over which a taxel's own drift is compared with it
SENSITIVITY_PRIOR = 0.0625  # of a taxel's noise squared: its zero's variance over that of sensitivities, 0.2^2
MIN_LEARNERS = 0.9  # of the taxels must be free while sensitivities are learnt: others have no say in their mean
MIN_SENSITIVITY = 0.1
TIME_S = 200.0  # time constant of the zero and its rate, critically damped: a steady drift leaves no error
SMOOTHING_S = 20.0  # of readings before they are compared with the band
LIFT_S = 60.0
SETTLE_S = 10.0  # that a taxel is free before its zero moves
MAX_GAP_S = 60.0  # between two blocks, that zeros move for: nobody saw what lay there in a longer one
NOISE_SIGMAS = 5.0  # of a mean: 1024 taxels pass it by chance once in an hour or less
QUIET_SIGMAS = 9.0  # span of a block's readings; the expected one is 3.5
ROUNDING_STEPS = 0.6  # by which rounding moves a mean, and twice as much a span
LIFTED = 0.3  # of its reading some LIFT_S ago: a loaded taxel that reads less may have been unloaded
MIN_VOTERS = 5  # their median withstands two that are wrong
MIN_REFERENCE_SQUARE = 4.0  # counts squared of the references' changes, from which their effect is judged
FELT = 1e-3  # of a contact's pressure: what is felt beyond its reach

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


class State(IntEnum):
    """What is known of a taxel's load: the first that applies.

    The zeros of free taxels and of those that read too little follow their readings, all others the common mode,
    which is the motion of the free ones.
    """

    UNREAD = 0  # missing, bad, dead or faulty
    LOADED = 1  # reads more than noise and drift explain, or is not quiet
    NEAR = 2  # within the cover's reach of a loaded one
    BELOW = 3  # reads less than zero: nothing pulls, so its zero is too high
    SETTLING = 4  # free for less than SETTLE_S
    FREE = 5


def reach_mm(kernel: Kernel) -> float:
    """Distance (mm) from the edge of a wide contact beyond which at most FELT of its pressure is felt.

    At d it is the integral of 2 r arccos(d / r) g(r) over r > d.
    """
    r, load = kernel.r[1:], 2 * kernel.r[1:] * np.abs(kernel.g[1:]) * np.diff(kernel.r)
    felt = [float((load[r > d] * np.arccos(d / r[r > d])).sum()) for d in r]
    return float(r[np.array(felt) > FELT][-1])


class Surroundings:
    """Which taxels are within `reach` (mm) of some: discs in a layout, squares in a grid, which cost less."""

    def __init__(self, array: Array, reach: float) -> None:
        self._shape, self._width = array.shape or (1, array.size), int(np.ceil(reach / array.pitch))
        self._within: Mask | None = None
        if array.shape is None:
            distance = np.linalg.norm(array.positions[:, None] - array.positions[None], axis=-1)
            self._within = distance <= reach

    def __call__(self, taxels: Mask) -> Mask:
        """(N,) within reach of any of `taxels` (N,), these included."""
        if self._within is not None:
            return np.asarray(self._within[taxels].any(axis=0))
        rows = _widened(taxels.reshape(self._shape), self._width)
        return _widened(rows.T, self._width).T.ravel()


def _widened(mask: Mask, width: int) -> Mask:
    """Each row's marks widened by `width` to both sides."""
    total = np.pad(np.cumsum(mask, axis=1), ((0, 0), (1, 0)))
    n = mask.shape[1]
    first, last = np.maximum(np.arange(n) - width, 0), np.minimum(np.arange(n) + width + 1, n)
    return np.asarray(total[:, last] > total[:, first])


class DriftTracker:
    """Zeros of N taxels as they drift, in counts over the zero of the last `reset`, by blocks of frames.

    `full_scale` is in counts; `sign` is -1 where counts fall under pressure.
    """

    def __init__(self, array: Array, reach: float, full_scale: float, sign: float = 1.0) -> None:
        self._around, self._full_scale, self._sign = Surroundings(array, reach), full_scale, sign
        self._sensitivity = _Sensitivity(array.size, full_scale)
        self._references = _References()
        self.reset(np.zeros(array.size, np.float32))

    def reset(self, no_load: NDArray[np.floating]) -> None:
        """Take `no_load` (N,) counts, just measured, as the zeros."""
        size = len(no_load)
        self._no_load = np.asarray(no_load, np.float32)
        self._zero = np.zeros(size, np.float32)
        self._rate = np.zeros(size, np.float32)  # counts a second, of the zero
        self._moved = np.zeros(size, np.float32)  # running mean of what its zero moved, counts a second
        self._smooth = np.zeros(size, np.float32)  # running mean of the readings over the zeros
        self._idle = np.zeros(size, np.float32)  # reading that slow motion alone, within MAX_RATE, explains
        self._peak = np.zeros(size, np.float32)  # of a loaded taxel, forgotten with LIFT_S
        self._lifted_s = np.full(size, np.inf, np.float32)  # since most of its load has gone
        self._missed = np.zeros(size, np.float32)  # drift that a loaded taxel's zero may lack
        self._free_s = np.full(size, SETTLE_S, np.float32)
        self.state = np.full(size, State.FREE, np.uint8)
        self.common = 0.0  # counts of the common mode since the reset
        self._time_s: float | None = None
        self._sensitivity.reset()

    def take_over(self, other: "DriftTracker", no_load: NDArray[np.floating]) -> None:
        """Go on from where `other` is, by this one's settings, if its zeros are of the same `no_load` (N,)."""
        if other._sign == self._sign and np.array_equal(other._no_load, no_load):
            own = self._around, self._full_scale
            vars(self).update(vars(other))
            self._around, self._full_scale = own

    @property
    def correction(self) -> Floats:
        """Counts (N,) to be added to the zeros of the reset."""
        return self._sign * self._zero

    def update(self, block: Block, sigma: Floats, usable: Mask, references: Floats | None = None) -> None:
        """Take a block, the noise (N,) of its taxels in counts, which of them work, and its reference pads."""
        gap = 0.0 if self._time_s is None else max(block.time_s - self._time_s, 0.0)
        self._time_s = block.time_s
        seconds = min(gap, MAX_GAP_S)
        reading = self._sign * (block.mean - self._no_load) - self._zero
        readable = block.readable & usable
        weight = min(1.0, seconds / SMOOTHING_S)
        self._smooth += np.where(readable, weight * (reading - self._smooth), 0)
        loaded, below = self._outside(block, reading, sigma, weight)
        was_loaded = self.state == State.LOADED
        self.state = self._judge(readable, loaded & readable, below, seconds)
        unloaded = was_loaded & (self.state > State.LOADED)
        self._idle[unloaded] = self._smooth[unloaded] = reading[unloaded]
        self._follow(reading, gap, seconds)
        self._move(seconds, sigma, references)

    def _outside(self, block: Block, reading: Floats, sigma: Floats, weight: float) -> tuple[Mask, Mask]:
        """Which taxels (N,) read more, and which less, than their noise and their drift explain."""
        rounding = ROUNDING_STEPS * block.step
        margin = BAND * self._full_scale + rounding
        lifted = self._lifted(reading, margin)
        wide = margin + np.where(lifted, self._missed, 0)
        noise = NOISE_SIGMAS * sigma / BLOCK_FRAMES**0.5
        smooth_noise = noise * (weight / (2 - weight)) ** 0.5  # of a running mean with that weight
        now, lately = reading - self._idle, self._smooth - self._idle
        lately[lifted] = now[lifted]
        moving = block.span > QUIET_SIGMAS * sigma + 2 * rounding
        above = (now > wide + noise) | (lately > wide + smooth_noise)
        return above | moving, (now < -wide - noise) | (lately < -wide - smooth_noise)

    def _lifted(self, reading: Floats, margin: float) -> Mask:
        """Loaded taxels (N,) that may be free now: most of their load has gone, or of one within reach."""
        loaded = (self.state == State.LOADED) & (reading < self._missed + margin)
        lifted = loaded & (reading < LIFTED * self._peak)
        self._lifted_s[lifted] = 0
        near = self._around(self._lifted_s < LIFT_S) if lifted.any() or loaded.any() else lifted
        return np.asarray(lifted | (loaded & near & (reading < self._peak - margin / 2)))

    def _judge(self, readable: Mask, loaded: Mask, below: Mask, seconds: float) -> NDArray[np.uint8]:
        """State (N,) of every taxel."""
        near = self._around(loaded)
        free = readable & ~near & ~below
        self._free_s = np.where(free, self._free_s + np.float32(seconds), np.float32(0))
        conditions = [~readable, loaded, near, below, self._free_s < SETTLE_S]
        return np.select(conditions, list(State)[:-1], State.FREE).astype(np.uint8)

    def _follow(self, reading: Floats, gap: float, seconds: float) -> None:
        """Follow what is known of each taxel while its zero may not: slow motion, and since when it is loaded."""
        loaded = self.state == State.LOADED
        limit = MAX_RATE * self._full_scale * seconds
        self._idle += np.where(loaded, 0, np.clip(self._smooth - self._idle, -limit, limit))
        self._lifted_s += np.float32(gap)
        forgotten = np.float32(np.exp(-gap / LIFT_S))
        self._peak = np.where(loaded, np.maximum(reading, reading + (self._peak - reading) * forgotten), 0)
        rate = FROZEN_RATE if self._votes() is not None else MAX_RATE
        missed = np.minimum(self._missed + rate * self._full_scale * gap, MAX_MISSED * self._full_scale)
        self._missed = np.where(loaded, missed, 0).astype(np.float32)

    def _votes(self) -> Mask | None:
        """Which taxels (N,) make up the common mode; None where they are too few."""
        voters = self.state == State.FREE
        return voters if np.count_nonzero(voters) >= MIN_VOTERS else None

    def _move(self, seconds: float, sigma: Floats, references: Floats | None) -> None:
        """Move the zeros: by their own readings, or by the common mode."""
        limit, sensitivity = MAX_RATE * self._full_scale, self._sensitivity.values
        part = min(1.0, seconds / TIME_S)
        own_rate = np.clip(self._rate + self._smooth * part / TIME_S, -limit, limit)
        if (voters := self._votes()) is not None:
            common = float(np.median(self._moved[voters] / sensitivity[voters]))
            self._references.learn(references, self.common + common * seconds, seconds)
        else:
            common = self._references.predict(references, seconds)
        votes = self.state == State.FREE
        follows = votes | (self.state == State.BELOW)
        common_rate = np.clip(common * sensitivity, -limit, limit)
        self._rate = np.where(follows, own_rate, common_rate).astype(np.float32)
        own = np.clip(self._rate * seconds + 2 * part * self._smooth, -limit * seconds, limit * seconds)
        step = np.where(follows, own, self._rate * seconds).astype(np.float32)
        if seconds:
            self._moved += np.float32(part) * (step / np.float32(seconds) - self._moved)
        self.common += common * seconds
        self._zero += step
        self._smooth -= step
        self._idle -= np.where(follows, step, 0)
        learning = np.count_nonzero(votes) >= MIN_LEARNERS * np.count_nonzero(self.state != State.UNREAD)
        self._sensitivity.learn(self._zero, self.common, votes if learning else np.zeros_like(votes), sigma)


class _Sensitivity:
    """Drift of each taxel over the common mode: 1 to begin with, learnt over its changes while it is free."""

    def __init__(self, taxels: int, full_scale: float) -> None:
        self._step = SENSITIVITY_STEP * full_scale
        self._prior = np.full(taxels, SENSITIVITY_PRIOR)
        self._product, self._square, self._zero, self._common = np.zeros((4, taxels))
        self._tracked = np.zeros(taxels, bool)  # free since its last comparison

    @property
    def values(self) -> NDArray[np.float64]:
        """(N,), of a regression through 0 with a prior of 1, over their median."""
        values = (self._prior + self._product) / (self._prior + self._square)
        return np.asarray(np.maximum(values / np.median(values), MIN_SENSITIVITY))

    def reset(self) -> None:
        """Begin new changes: the zeros have been set."""
        self._tracked[:] = False

    def learn(self, zero: Floats, common: float, free: Mask, sigma: Floats) -> None:
        """Compare the zeros' changes with those of the common mode, for readings with noise `sigma` (N,)."""
        self._prior = SENSITIVITY_PRIOR * np.square(sigma, dtype=float)
        change = common - self._common
        due = free & self._tracked & (np.abs(change) >= self._step)
        self._product[due] += (zero[due] - self._zero[due]) * change[due]
        self._square[due] += change[due] ** 2
        start = due | (free & ~self._tracked)
        self._zero[start], self._common[start] = zero[start], common
        self._tracked[:] = free


class _References:
    """What pads that feel no pressure say of the common mode, where too few taxels are free to show it."""

    def __init__(self) -> None:
        self._smooth = np.nan  # counts, running mean over the pads
        self._anchor: tuple[float, float] | None = None  # smooth reference and common mode
        self._product = self._square = 0.0

    def learn(self, references: Floats | None, common: float, seconds: float) -> None:
        """Compare their change with the common mode's."""
        if self._follow(references, seconds) is None:
            return
        if self._anchor is None:
            self._anchor = self._smooth, common
        change = self._smooth - self._anchor[0]
        if abs(change) >= 1.0:
            self._product += change * (common - self._anchor[1])
            self._square += change**2
            self._anchor = self._smooth, common

    def predict(self, references: Floats | None, seconds: float) -> float:
        """Rate (counts a second) of the common mode since the last block; 0 where their effect is not known."""
        self._anchor = None
        change = self._follow(references, seconds)
        if change is None or not seconds or self._square < MIN_REFERENCE_SQUARE:
            return 0.0
        return self._product / self._square * change / seconds

    def _follow(self, references: Floats | None, seconds: float) -> float | None:
        """By how much (counts) their running mean changes; None where no pad is read."""
        if references is None or not np.isfinite(references).any():
            return None
        mean = float(np.nanmean(references))
        before = mean if np.isnan(self._smooth) else self._smooth
        self._smooth = before + min(1.0, seconds / TIME_S) * (mean - before)
        return self._smooth - before
