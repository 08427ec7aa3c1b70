"""Blocks of successive frames: mean, span and noise of each taxel."""

from functools import cached_property

import numpy as np

from tactiled.arrays import Flags, Floats, Floats32, Mask
from tactiled.frames import BAD, MISSING, Counts

BLOCK_FRAMES = 16  # successive ones: noise shows in their differences, and a walking foot stands longer
BLOCK_PERIOD_S = 1.0  # from block to block at least: what looks at blocks costs a few microseconds a frame
DIFFERENCE_VARIANCE = 70.0  # of fourth differences, over that of the noise
KNOWN_BLOCKS = 20  # before which noise is not judged
MEDIAN_VARIANCE = 0.855  # median over mean of `Block.variance`: 2e5 blocks of white noise
MAX_UNEVENNESS = 1.5  # longest over shortest period, above which a load that moves changes readings like noise
REST_SIGMAS = 2.0  # of the noise: if a block's mean is further from no load, something lies there
MIN_LEARNING = 0.05  # part by which a block changes the running noise; the n-th block 1 / n before that
MIN_NOISE = 0.05  # steps: the running noise stays above it, so that it comes up again in seconds


class Block:
    """Successive frames (K, N) in counts, of an array whose counts differ by multiples of `step`."""

    def __init__(self, times_s: Floats, counts: Floats32, readable: Mask, step: float) -> None:
        self.time_s = float(times_s[-1])  # of the last frame
        periods = np.diff(times_s)
        self.even = bool(periods.max() <= MAX_UNEVENNESS * periods.min())  # its frames come evenly
        self.counts = counts  # the collector's own: valid until its next frame
        self.readable = readable  # (N,) neither missing nor bad in any of the frames
        self.step = step  # counts
        self.mean: Floats32 = counts.mean(axis=0)
        self.span: Floats32 = counts.max(axis=0) - counts.min(axis=0)

    @cached_property
    def fourth(self) -> Floats32:
        """Fourth differences (K - 4, N) in time, which a rubbing finger hardly changes."""
        return np.diff(self.counts, 4, axis=0)

    @cached_property
    def variance(self) -> Floats32:
        """Variance (N,) of the noise, by fourth differences."""
        squares = np.einsum("kn,kn->n", self.fourth, self.fourth)
        return np.asarray(squares / (DIFFERENCE_VARIANCE * len(self.fourth)), np.float32)


class Blocks:
    """Collects BLOCK_FRAMES successive frames of N taxels, then pauses until BLOCK_PERIOD_S after their first."""

    def __init__(self, taxels: int) -> None:
        self._counts = np.zeros((BLOCK_FRAMES, taxels), np.float32)
        self._flags = np.zeros(taxels, np.uint8)
        self._times_s = np.zeros(BLOCK_FRAMES)
        self._frames = 0  # of the block under way
        self._began_s = -np.inf
        self._step = np.inf

    def collect(self, time_s: float, counts: Counts, flags: Flags) -> Block | None:
        """Take a frame, (N,) counts and flags; gives a block once it is complete."""
        if not self._frames:
            if 0 <= time_s - self._began_s < BLOCK_PERIOD_S:
                return None
            self._began_s = time_s
            self._flags[:] = 0
        self._counts[self._frames], self._times_s[self._frames] = counts, time_s
        self._flags |= flags
        self._frames += 1
        if self._frames < BLOCK_FRAMES:
            return None
        self._frames = 0
        change = np.abs(np.diff(self._counts, axis=0))
        np.copyto(change, np.inf, where=change == 0)
        self._step = min(self._step, float(change.min()))  # the counts', as far as it shows
        step = self._step if np.isfinite(self._step) else 1.0
        return Block(self._times_s, self._counts, self._flags & (MISSING | BAD) == 0, step)

    def restart(self) -> None:
        """Drop the block under way."""
        self._frames, self._began_s = 0, -np.inf


class TaxelNoise:
    """Running median over blocks of each taxel's noise; what moves on a taxel now and then does not change it.

    What lies on a taxel may move between frames that come unevenly: such blocks count where nothing lies.
    """

    def __init__(self, taxels: int) -> None:
        self._variance = np.zeros(taxels, np.float32)
        self._blocks = np.zeros(taxels, np.float32)
        self._step = 1.0

    @property
    def sigma(self) -> Floats32:
        """Standard deviation (N,) in counts, not under that of rounding."""
        return np.sqrt(np.maximum(self._variance, self._step**2 / 12))

    @property
    def seen(self) -> Mask:
        """(N,) taxels that were seen in a block; the others' noise is unknown."""
        return self._blocks > 0

    @property
    def reliable(self) -> Mask:
        """(N,) taxels that were seen in enough blocks."""
        return self._blocks >= KNOWN_BLOCKS

    def update(self, block: Block, load: Floats32) -> None:
        """Take a block with its mean load (N,), counts; a variance goes a part of itself towards the block's."""
        readable = block.readable
        if not block.even:
            readable = readable & (np.abs(load) < REST_SIGMAS * self.sigma)
        self._step = block.step
        variance = block.variance / MEDIAN_VARIANCE
        first = readable & (self._blocks == 0)
        self._variance[first] = variance[first]
        learning = np.maximum(1 / (self._blocks + 1), MIN_LEARNING)
        factor = np.exp(learning * np.sign(variance - self._variance))
        np.multiply(self._variance, factor, out=self._variance, where=readable)
        np.maximum(self._variance, (MIN_NOISE * block.step) ** 2, out=self._variance)
        self._blocks += readable
