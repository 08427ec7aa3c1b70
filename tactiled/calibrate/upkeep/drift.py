"""Drift of the taxels' zeros, followed only where nothing can lie on a taxel.

A taxel that reads zero, is quiet and lies beyond the cover's reach of every contact is free: its zero follows its
reading. The zeros of all others follow the common mode of the free ones alone, each as strongly as it did while it
was free itself, so that a load never becomes a zero. Two loads look like drift: one that comes slower than
MAX_RATE, and one on the whole array that comes slower than SHARED_RATE, as when an array warms up.
"""

from enum import IntEnum

import numpy as np

from tactiled.arrays import Flags, Floats32, Mask, Reals
from tactiled.calibrate.upkeep.blocks import BLOCK_FRAMES, Block
from tactiled.calibrate.upkeep.common_mode import TIME_S, References, Sensitivity
from tactiled.calibrate.upkeep.neighbourhood import SHARE, Neighbourhood
from tactiled.cover.kernel import Kernel
from tactiled.geometry import Array

# Parts of full scale. The claims (tests/calibrate/upkeep/test_drift.py) are for 5 % of full scale an hour.
MAX_RATE = 0.10 / 3600  # a second, of a zero against the common mode: a load that grows over 10 s loses 0.03 %
SHARED_RATE = 0.03 / 60  # a second, of the motion that all free taxels share
SHARED = 0.0015  # least median of the free taxels that is followed as shared motion
MIN_SHARED = 0.25  # of that median: each part of the array reads so much, or there is no shared motion
PARTS, PART_TAXELS = 4, 9  # parts along each side of the array, and the fewest taxels of a part
SHARED_SPREAD = 2.0  # times that median: how far beyond it some taxels read
SHARED_TIME_S, OWN_TIME_S = 2.0, 10.0  # in which zeros follow the shared motion, and what each taxel reads besides
BAND = 0.002  # how far beyond its noise a free taxel may read
FROZEN_RATE = 0.01 / 3600  # a second, of a loaded taxel's drift that the common mode misses: 20 % of 5 % an hour
MAX_MISSED = 0.10  # of such drift in all
MIN_LEARNERS = 0.9  # of the taxels that must be free for sensitivities to be learnt: only they count in the mean
SMOOTHING_S = 20.0  # of readings before they are compared with the band
LIFT_S = 60.0
HELD_S = 900.0  # in which the last rate of the common mode fades, while no taxel is free to show it
SETTLE_S = 10.0  # how long a taxel is free before its zero moves
MAX_GAP_S = 60.0  # longest gap between two blocks over which zeros move: in a longer one a load may have come
NOISE_SIGMAS = 5.0  # of a mean: 1024 taxels pass it by chance once in an hour or less
QUIET_SIGMAS = 9.0  # span of a block's readings; the expected one is 3.5
ROUNDING_STEPS = 0.6  # steps by which rounding moves a mean; a span moves by twice as much
LIFTED = 0.3  # of its reading some LIFT_S ago: a loaded taxel that reads less may have been unloaded
MIN_VOTERS = 5  # their median withstands two that are wrong
ALONE_SIGMAS, ALONE_ERROR = 2.0, BAND / 4  # standard deviations of the neighbours' sum, and a zero's error in it
FELT = 1e-3  # of a contact's pressure: what is felt beyond its reach


class DriftState(IntEnum):
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


def _parts(array: Array) -> list[Mask]:
    """The taxels (N,) of each part of the array."""
    side = int(np.clip((array.size / PART_TAXELS) ** 0.5, 1, PARTS))
    order = np.argsort(np.argsort(array.positions, axis=0, kind="stable"), axis=0)
    column, row = (order * side // array.size).T
    return [(column == a) & (row == b) for a in range(side) for b in range(side)]


def _median(values: Floats32) -> np.float32:
    """As `np.median` of some numbers, in a fifth of its time."""
    low, high = (values.size - 1) // 2, values.size // 2
    middle = np.partition(values, (low, high))
    return np.float32((middle[low] + middle[high]) / 2)


class DriftTracker:
    """Zeros of N taxels as they drift, in counts over the zero of the last `reset`, by blocks of frames.

    `full_scale` is in counts; `sign` is -1 where counts fall under pressure.
    """

    def __init__(
        self,
        array: Array,
        reach: float,
        full_scale: float,
        sign: float = 1.0,
        neighbourhood: Neighbourhood | None = None,
    ) -> None:
        self._neighbourhood = neighbourhood
        self._around, self._full_scale, self._sign = Surroundings(array, reach), full_scale, sign
        self._parts = _parts(array)
        self._sensitivity = Sensitivity(array.size, full_scale)
        self._references = References()
        self.reset(np.zeros(array.size, np.float32))

    def reset(self, no_load: Reals) -> None:
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
        self.state = np.full(size, DriftState.FREE, np.uint8)
        self.common = 0.0  # counts of the common mode since the reset
        self._common_rate = 0.0  # counts a second, the shared motion included
        self._shared_rate = 0.0  # counts a second: running mean of the shared motion
        self._shared, self._stepped_s = 0.0, np.inf  # median of the free readings, and since it jumped
        self._alike = 0.0  # counts by which the band is wider after a shared motion
        self._time_s: float | None = None
        self._sensitivity.reset()

    def take_over(self, other: "DriftTracker", no_load: Reals) -> None:
        """Go on from where `other` is, by this one's settings, if its zeros are of the same `no_load` (N,)."""
        if other._sign == self._sign and np.array_equal(other._no_load, no_load):
            own = self._around, self._full_scale, self._neighbourhood
            vars(self).update(vars(other))
            self._around, self._full_scale, self._neighbourhood = own

    @property
    def correction(self) -> Floats32:
        """Counts (N,) to be added to the zeros of the reset."""
        return self._sign * self._zero

    def update(self, block: Block, sigma: Floats32, usable: Mask, references: Floats32 | None = None) -> None:
        """Take a block, the noise (N,) of its taxels in counts, which of them work, and its reference pads."""
        gap = 0.0 if self._time_s is None else max(block.time_s - self._time_s, 0.0)
        self._time_s = block.time_s
        seconds = min(gap, MAX_GAP_S)
        reading = self._sign * (block.mean - self._no_load) - self._zero
        readable = block.readable & usable
        self._follow_all(reading, readable, gap, seconds)
        weight = min(1.0, seconds / SMOOTHING_S)
        self._smooth += np.where(readable, weight * (reading - self._smooth), 0)
        loaded, below = self._outside(block, reading, sigma, weight)
        loaded &= ~self._alone(loaded & readable & (block.span <= QUIET_SIGMAS * sigma), readable, sigma, weight)
        was_loaded = self.state == DriftState.LOADED
        self.state = self._judge(readable, loaded & readable, below, seconds)
        unloaded = was_loaded & (self.state > DriftState.LOADED)
        self._idle[unloaded] = self._smooth[unloaded] = reading[unloaded]
        self._follow(reading, gap, seconds)
        self._move(seconds, sigma, references)

    def _follow_all(self, reading: Floats32, readable: Mask, gap: float, seconds: float) -> None:
        """Move zeros and `reading` (N,) by what all parts of the array read alike: no contact is on all."""
        self._stepped_s += gap
        self._shared_rate *= 1 - min(1.0, seconds / TIME_S)
        self._alike *= float(np.exp(-gap / SMOOTHING_S))
        free = readable & (self.state >= DriftState.BELOW)
        of_parts = [reading[each & free] for each in self._parts]
        medians = np.array([_median(each) for each in of_parts if each.size >= MIN_VOTERS])
        if len(medians) <= len(self._parts) / 2:
            return
        shared, limit = float(np.median(medians)), SHARED_RATE * self._full_scale * seconds
        if abs(shared - self._shared) > limit + SHARED * self._full_scale:
            self._stepped_s = 0.0
        self._shared = shared
        alike = (medians * np.sign(shared) > MIN_SHARED * abs(shared)).all() and len(self._parts) > 1
        if not alike or abs(shared) < SHARED * self._full_scale or self._stepped_s < LIFT_S:
            return
        self._alike = max(self._alike, SHARED_SPREAD * abs(shared))
        expected = (shared * self._sensitivity.values).astype(np.float32)
        own = np.where(free, reading - expected, 0)
        part, own_part = min(1.0, seconds / SHARED_TIME_S), min(1.0, seconds / OWN_TIME_S)
        step = np.clip(expected * part + own * own_part, -2 * limit, 2 * limit).astype(np.float32)
        self._zero += step
        reading -= step  # but not `_smooth`, the mean of what such steps have left
        self._shared -= shared * part
        moved = float(np.clip(shared * part, -limit, limit))
        self.common += moved
        self._shared_rate += moved / TIME_S

    def _outside(self, block: Block, reading: Floats32, sigma: Floats32, weight: float) -> tuple[Mask, Mask]:
        """Which taxels (N,) read more, and which less, than their noise and their drift explain."""
        rounding = ROUNDING_STEPS * block.step
        margin = BAND * self._full_scale + rounding
        lifted = self._lifted(reading, margin)
        wide = margin + self._alike + np.where(lifted, self._missed, 0)
        noise = NOISE_SIGMAS * sigma / BLOCK_FRAMES**0.5
        smooth_noise = noise * (weight / (2 - weight)) ** 0.5  # of a running mean with that weight
        now, lately = reading - self._idle, self._smooth - self._idle
        lately[lifted] = now[lifted]
        moving = block.span > QUIET_SIGMAS * sigma + 2 * rounding
        above = (now > wide + noise) | (lately > wide + smooth_noise)
        return above | moving, (now < -wide - noise) | (lately < -wide - smooth_noise)

    def _alone(self, loaded: Mask, readable: Mask, sigma: Floats32, weight: float) -> Mask:
        """Loaded taxels (N,) whose neighbours read less than any load gives them: they drift by themselves."""
        alone = np.zeros_like(loaded)
        if self._neighbourhood is not None and loaded.any():
            near = readable & (
                self.state == DriftState.NEAR
            )  # their zeros lag as far behind the drift as its neighbours'
            over = self._smooth - np.median(self._smooth[near if near.any() else readable])
            taxels = self._neighbourhood.peaks(np.flatnonzero(loaded), over)
            error = weight / (2 - weight) * sigma**2 / BLOCK_FRAMES + (ALONE_ERROR * self._full_scale) ** 2
            (total, variance), share = self._neighbourhood.beside(taxels, np.stack([over, error]), readable)
            alone[taxels] = total + ALONE_SIGMAS * np.sqrt(variance) < SHARE * share * over[taxels]
        return alone

    def _lifted(self, reading: Floats32, margin: float) -> Mask:
        """Loaded taxels (N,) that may be free now: most of their load has gone, or of one within reach."""
        loaded = (self.state == DriftState.LOADED) & (reading < self._missed + margin)
        lifted = loaded & (reading < LIFTED * self._peak)
        self._lifted_s[lifted] = 0
        near = self._around(self._lifted_s < LIFT_S) if lifted.any() or loaded.any() else lifted
        return np.asarray(lifted | (loaded & near & (reading < self._peak - margin / 2)))

    def _judge(self, readable: Mask, loaded: Mask, below: Mask, seconds: float) -> Flags:
        """State (N,) of every taxel."""
        near = self._around(loaded)
        free = readable & ~near & ~below
        self._free_s = np.where(free, self._free_s + np.float32(seconds), np.float32(0))
        conditions = [~readable, loaded, near, below, self._free_s < SETTLE_S]
        return np.select(conditions, list(DriftState)[:-1], DriftState.FREE).astype(np.uint8)

    def _follow(self, reading: Floats32, gap: float, seconds: float) -> None:
        """Follow what is known of each taxel while its zero may not: slow motion, and since when it is loaded."""
        loaded = self.state == DriftState.LOADED
        limit = (MAX_RATE * self._full_scale + abs(self._common_rate)) * seconds
        self._idle += np.where(loaded, 0, np.clip(self._smooth - self._idle, -limit, limit))
        self._lifted_s += np.float32(gap)
        forgotten = np.float32(np.exp(-gap / LIFT_S))
        self._peak = np.where(loaded, np.maximum(reading, reading + (self._peak - reading) * forgotten), 0)
        rate = FROZEN_RATE if self._votes() is not None else MAX_RATE
        missed = np.minimum(self._missed + rate * self._full_scale * gap, MAX_MISSED * self._full_scale)
        self._missed = np.where(loaded, missed, 0).astype(np.float32)

    def _votes(self) -> Mask | None:
        """Which taxels (N,) make up the common mode; None where they are too few."""
        voters = self.state == DriftState.FREE
        return voters if np.count_nonzero(voters) >= MIN_VOTERS else None

    def _move(self, seconds: float, sigma: Floats32, references: Floats32 | None) -> None:
        """Move the zeros: by their own readings, or by the common mode."""
        limit, sensitivity = MAX_RATE * self._full_scale + abs(self._common_rate), self._sensitivity.values
        votes, part = self.state == DriftState.FREE, min(1.0, seconds / TIME_S)
        own_rate = np.clip(self._rate + self._smooth * part / TIME_S, -limit, limit)
        if (voters := self._votes()) is not None:
            common = float(np.median(self._moved[voters] / sensitivity[voters]))
            self._references.learn(references, self.common + common * seconds, seconds)
        else:
            common = self._references.predict(references, seconds, self._common_rate * np.exp(-seconds / HELD_S))
        fastest = SHARED_RATE * self._full_scale
        self._common_rate = float(
            np.clip(common + (self._shared_rate if voters is not None else 0), -fastest, fastest)
        )
        follows = votes | (self.state == DriftState.BELOW)
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
        learning = np.count_nonzero(votes) >= MIN_LEARNERS * np.count_nonzero(self.state != DriftState.UNREAD)
        self._sensitivity.learn(self._zero, self.common, votes if learning else np.zeros_like(votes), sigma)
