"""Taxels that do not work, found while the array is in use, and found to work again.

What a fault looks like is compared with what no load can do. What presses on the taxels around a taxel presses on
it, too, as far as the cover joins them; noise of more than a count never stands still; a load shakes or saturates
a taxel's neighbours with it. All of it must come again and again.
"""

from enum import IntEnum
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tactiled.arrays import Floats32, Ints, Mask, Reals
from tactiled.calibrate.upkeep.blocks import DIFFERENCE_VARIANCE, KNOWN_BLOCKS, Block, TaxelNoise
from tactiled.calibrate.upkeep.neighbourhood import SHARE, Neighbourhood
from tactiled.geometry import Array

# `python -m tests.bench health` counts faults found on healthy arrays and the frames until a fault is found.
NEIGHBOUR_PITCHES = 1.6  # distance of a neighbour: the eight around a taxel of a grid
OPPOSITE_PITCHES = 0.3  # from a taxel to the middle of two opposite neighbours
LOADED_SIGMAS, LOADED = 8.0, 0.02  # of noise, and part of full scale: a taxel that reads more is loaded
# Of the least that a working taxel reads under a press: with less it is dead, or weak. It heals with WEAK_RATIO of
# what its neighbours read.
DEAD_RATIO, WEAK_RATIO = 0.25, 0.5
CLEAR_SIGMAS, CLEAR = 2.0, 0.001  # of noise, and part of full scale, from which that least is certain
STUCK_NOISE = 1.0  # steps: rounded noise of less may stand still; alternating between two steps shows 0.82
NOISY_RATIO = 5.0  # of a taxel's noise to the median of those that are known
SHARE_ERRORS = 4.0  # a share that is measured counts where so many standard errors are smaller
MIN_POOLED = 5  # blocks that a share is measured from
MOVING = 3.0  # times the variance of the neighbours' sum: in a block with more a load moves, and it is left out
CORRELATED = 2.63  # variance of products of fourth differences over that of independent ones: 70, 56, 28, 8, 1
QUIET = 0.1, 0.4  # what a quiet block counts against noise: before a taxel is found noisy, and after
ZERO_ERROR, ZERO_SIGMAS = 0.002, 2.0  # of full scale, of a drifting zero; standard deviations that count

Evidence = Reals | Mask


class Fault(IntEnum):
    """What is wrong with a taxel; of several, the first of RULES."""

    HEALTHY = 0
    STUCK = 1
    SATURATED = 2
    NOISY = 3
    DEAD = 4
    WEAK = 5
    SWAPPED = 6


class Rule(NamedTuple):
    """How a fault is found: evidence for it adds up to `threshold`, evidence against it is subtracted."""

    threshold: int  # blocks, or presses on its neighbours
    in_a_row: bool  # before the fault is found, one piece of evidence against it resets the sum
    reason: str


RULES = {
    Fault.SWAPPED: Rule(1, False, "it feels what lies on another taxel's place"),  # by `map_monitor`
    Fault.STUCK: Rule(6, True, "its reading does not change, as noise or no load would let it"),
    Fault.SATURATED: Rule(20, True, "it stays at its ceiling, and its neighbours feel no such load"),
    Fault.NOISY: Rule(20, False, "it is noisy, and its neighbours feel nothing of it"),
    Fault.DEAD: Rule(3, True, "it feels no load, and its neighbours do"),
    Fault.WEAK: Rule(5, True, "it feels less than half of what its neighbours leave on it"),
}


# Whether what a taxel reads says nothing of the load, by its fault.
UNRELATED = np.isin(np.arange(len(Fault)), (Fault.STUCK, Fault.SATURATED, Fault.NOISY))


class Change(NamedTuple):
    """A taxel whose state has changed."""

    time_s: float
    taxel: int
    before: Fault
    after: Fault


class TaxelHealth:
    """State of N taxels, by blocks of frames.

    `ends` are the counts at which a taxel is empty and saturated, infinite where nobody knows; `full_scale` the
    counts between them, or the codec's; `calibrated`: each gain was measured, so that a weak taxel is a fault.
    """

    def __init__(
        self,
        array: Array,
        neighbourhood: Neighbourhood,
        ends: tuple[float, float],
        full_scale: float,
        calibrated: bool = False,
    ) -> None:
        n = array.size
        self._neighbourhood = neighbourhood
        self._pairs = opposite_pairs(array)
        self._ends, self.full_scale, self._calibrated = ends, full_scale, calibrated
        self._scores = {fault: np.zeros(n, np.float32) for fault in RULES}
        self._active = {fault: np.zeros(n, bool) for fault in RULES}
        self.faults = np.zeros(n, np.uint8)
        self.since_s = np.full(n, np.nan)  # of the present state; NaN: since the start
        self._blocks = 0
        self._mean = np.full(n, np.nan, np.float32)  # of the last block
        self._presses, self._shaking = _Presses(n), _Shares(n)
        self._rising = 1 if ends[1] > ends[0] else -1

    def update(
        self, block: Block, noise: TaxelNoise, load: Floats32, usable: Mask, swapped: Mask, measured: bool = True
    ) -> list[Change]:
        """Take a block, its taxels' noise, load over zero (N,) in counts, which are in use, which are swapped.

        The zeros were `measured`, so that a reading below zero is no offset.
        """
        readable, sigma = block.readable & usable, noise.sigma
        self._score(Fault.SWAPPED, swapped, ~swapped)
        self._blocks += 1
        above, below = self._unexplained(sigma, load, readable, measured)
        self._look_at_stillness(block, sigma, readable, above | below)
        self._look_at_noise(block, noise, load, readable, measured)
        top = self._at_ceiling(block)
        self._score(Fault.SATURATED, readable & top & above, readable & ~top)
        self._look_at_presses(sigma, load, readable & ~top)
        self._mean = np.where(readable, block.mean, np.float32(np.nan))
        return self._changes(block.time_s)

    def take_over(self, other: "TaxelHealth") -> None:
        """Go on with the evidence that another has of the same taxels."""
        self._scores, self._active, self._blocks = other._scores, other._active, other._blocks
        self.faults, self.since_s = other.faults, other.since_s

    def _score(self, fault: Fault, evidence: Evidence, against: Evidence) -> None:
        """Add what speaks for a fault and what speaks against it, both (N,)."""
        rule, score, active = RULES[fault], self._scores[fault], self._active[fault]
        score += evidence.astype(np.float32)
        score -= against.astype(np.float32)
        if rule.in_a_row:
            score[np.greater(against, 0) & ~active] = 0
        np.clip(score, 0, rule.threshold, out=score)
        active |= score >= rule.threshold
        active &= score > 0

    def _at_ceiling(self, block: Block) -> Mask:
        ceiling = self._ends[1]
        return np.asarray(self._rising * (block.mean - ceiling) >= 0)

    def _unexplained(self, sigma: Floats32, load: Floats32, readable: Mask, measured: bool) -> tuple[Mask, Mask]:
        """Taxels (N,) whose reading no load explains: high without their neighbours, or far below zero."""
        clear = np.abs(load) > np.maximum(LOADED_SIGMAS * sigma, LOADED * self.full_scale)
        suspects = self._neighbourhood.peaks(np.flatnonzero(readable & clear), np.abs(load))
        above, below = np.zeros_like(readable), np.zeros_like(readable)
        if suspects.size:
            variance = (ZERO_ERROR * self.full_scale) ** 2 + sigma**2
            values = np.stack([load, np.abs(load), load**2, variance, np.ones_like(load)])
            trusted = readable & (self.faults == Fault.HEALTHY)
            (total, felt, squares, variance, count), share = self._neighbourhood.beside(suspects, values, trusted)
            own, error = load[suspects], ZERO_SIGMAS * np.sqrt(variance)
            above[suspects] = (np.abs(total) if measured else felt) + error < SHARE * share * own
            below[suspects] = measured & (count > 0) & (np.sqrt(squares) < -SHARE * own)
        return above, below

    def _look_at_stillness(self, block: Block, sigma: Floats32, readable: Mask, unexplained: Mask) -> None:
        judged = readable & (self._blocks > KNOWN_BLOCKS)
        trembles = sigma >= STUCK_NOISE * block.step
        still = (block.span == 0) & (block.mean == self._mean)
        peers = readable & trembles
        moving = np.count_nonzero(peers & (block.span > 0)) * 2 > np.count_nonzero(peers | (readable & still))
        inside = (block.mean > min(self._ends)) & (block.mean < max(self._ends))
        trembled = trembles | (self._scores[Fault.STUCK] > 0)
        stuck = still & ((inside & moving & trembled) | (unexplained & ~self._at_ceiling(block)))
        self._score(Fault.STUCK, judged & stuck, readable & ~still)

    def _look_at_noise(
        self, block: Block, noise: TaxelNoise, load: Floats32, readable: Mask, measured: bool
    ) -> None:
        sigma, known = noise.sigma, readable & noise.seen
        typical = float(np.median(sigma[known])) if known.any() else np.inf
        now = np.sqrt(block.variance)
        noisy = readable & (now > NOISY_RATIO * typical) & (self._blocks > KNOWN_BLOCKS)
        own, joined, pulled = np.zeros((3, *noisy.shape), bool)
        if (suspects := np.flatnonzero(noisy)).size:
            values = np.vstack([block.fourth, sigma**2])
            trusted = readable & (self.faults == Fault.HEALTHY)
            beside, share = self._neighbourhood.beside(suspects, values, trusted)
            alone, resolved = self._shaking.add(suspects, block.fourth[:, suspects], beside, share)
            own[suspects], joined[suspects] = resolved & alone, resolved & ~alone
            over = self._rising * (block.counts[:, suspects] - block.mean[suspects]) + load[suspects]
            zero = block.mean[suspects] - self._rising * load[suspects]
            shaking = np.minimum(now[suspects], np.abs(zero - self._ends[0]) / 2)  # it cannot read less than empty
            pulled[suspects] = measured & (over.min(axis=0) < -shaking - ZERO_ERROR * self.full_scale)
        quiet = np.where(self._active[Fault.NOISY], *QUIET[::-1]) * (readable & ~noisy)
        enough = RULES[Fault.NOISY].threshold
        self._score(Fault.NOISY, np.where(own, enough, pulled), np.where(joined & ~pulled, enough, quiet))

    def _look_at_presses(self, sigma: Floats32, load: Floats32, readable: Mask) -> None:
        healthy = readable & (self.faults == Fault.HEALTHY)
        padded = np.append(np.where(healthy, load, np.float32(-np.inf)), np.float32(-np.inf))
        opposite = padded[self._pairs].min(axis=0).max(axis=0)
        needed = np.maximum(LOADED_SIGMAS * sigma, LOADED * self.full_scale)
        presses = self._presses
        presses.look(load, opposite, needed)
        explained = UNRELATED[self.faults] | (self.faults == Fault.SWAPPED)
        suspects = np.flatnonzero(presses.low & readable & ~explained)
        if suspects.size:
            lowest = self._neighbourhood.lowest(suspects, load - presses.rest, healthy & ~presses.low)
            clear = np.maximum(CLEAR_SIGMAS * sigma, CLEAR * self.full_scale)[suspects]
            presses.compare(load, suspects, lowest, clear)
        ended, like, part = presses.end(load, opposite, needed)
        judged = ended & readable & ~explained
        dead = judged & (part < DEAD_RATIO)
        weak = judged & ~dead & (part < WEAK_RATIO) & self._calibrated
        well = judged & (like >= WEAK_RATIO)
        self._score(Fault.DEAD, dead, well | (judged & (part >= DEAD_RATIO) & np.isfinite(part)))
        self._score(Fault.WEAK, weak, well)

    def _changes(self, time_s: float) -> list[Change]:
        """Set the present states; gives those that have changed."""
        faults = np.select([self._active[fault] for fault in RULES], list(RULES), Fault.HEALTHY).astype(np.uint8)
        changed = np.flatnonzero(faults != self.faults)
        changes = [Change(time_s, int(at), Fault(self.faults[at]), Fault(faults[at])) for at in changed]
        self.faults, self.since_s[changed] = faults, time_s
        return changes


class _Presses:
    """Presses on each taxel's neighbours, and its own best response to each."""

    def __init__(self, taxels: int) -> None:
        self.rest = np.zeros(taxels, np.float32)  # a taxel's load before the press
        self.low = np.zeros(taxels, bool)  # it feels less than WEAK_RATIO of the press now
        self._rest_beside = np.zeros(taxels, np.float32)
        self._like = np.full(taxels, -np.inf, np.float32)  # best response over its neighbours'; -inf: no press
        self._part = np.full(taxels, np.inf, np.float32)  # over the least that it may be; inf: never known

    def look(self, load: Floats32, opposite: Floats32, needed: Floats32) -> None:
        """Take the loads (N,) on a taxel and on the less loaded of two opposite neighbours, `needed` for one."""
        pressed = opposite - self._rest_beside
        on = pressed > needed
        like = np.divide(load - self.rest, pressed, out=np.full_like(load, -np.inf), where=on)
        np.maximum(self._like, like, out=self._like)
        self.low = on & (like < WEAK_RATIO)

    def compare(self, load: Floats32, taxels: Ints, lowest: Floats32, clear: Floats32) -> None:
        """Compare the loads of `taxels` with the least that they may be, where that is over `clear`."""
        certain = lowest > clear
        at = taxels[certain]
        part = (load - self.rest)[at] / lowest[certain]
        self._part[at] = np.where(np.isfinite(self._part[at]), np.maximum(self._part[at], part), part)

    def end(self, load: Floats32, opposite: Floats32, needed: Floats32) -> tuple[Mask, Floats32, Floats32]:
        """The taxels (N,) on whose neighbours a press has ended, and their best response over both measures."""
        released = opposite < needed / 2
        ended = released & (self._like > -np.inf)
        like, part = self._like.copy(), self._part.copy()
        self._like[released], self._part[released] = -np.inf, np.inf
        self.rest[released], self._rest_beside[released] = load[released], np.maximum(opposite[released], 0)
        return ended, like, part


class _Shares:
    """How much the neighbours of noisy taxels sense of their noise, pooled over blocks."""

    def __init__(self, taxels: int) -> None:
        self._sums = np.zeros((4, taxels))  # own square, product with the neighbours' sum, its variance, blocks

    def add(self, taxels: Ints, own: Floats32, beside: Floats32, share: Floats32) -> tuple[Mask, Mask]:
        """Take fourth differences (K, k) of k taxels, and of their neighbours' sum with its variance (K + 1, k).

        Gives which taxels (k,) give less than `share` of it to their neighbours, and for which that is certain.
        """
        square, variance = np.einsum("tk,tk->k", own, own), DIFFERENCE_VARIANCE * beside[-1]
        beside = beside[:-1]
        still = np.einsum("tk,tk->k", beside, beside) < MOVING * len(beside) * variance
        terms = [square, np.einsum("tk,tk->k", own, beside), CORRELATED * variance * square, np.ones(len(taxels))]
        self._sums[:, taxels] += np.where(still, terms, 0.0)
        square, product, variance, blocks = self._sums[:, taxels]
        margin = SHARE_ERRORS * np.sqrt(variance)
        resolved = (blocks >= MIN_POOLED) & (margin < SHARE * share * square)
        self._sums[:, taxels[resolved]] = 0
        return product < SHARE * share * square, resolved


def opposite_pairs(array: Array) -> Ints:
    """Pairs (2, 4, N) of opposite neighbours of every taxel; N where there are no more."""
    tree = cKDTree(array.positions)
    near: Any = tree.query_ball_point(array.positions, NEIGHBOUR_PITCHES * array.pitch)  # sorted lists of int
    neighbours = np.full((array.size, 8), array.size)
    for taxel, indices in enumerate(near):
        others = [each for each in indices if each != taxel][:8]
        neighbours[taxel, : len(others)] = others
    around = np.vstack([array.positions, (np.nan, np.nan)])[neighbours] - array.positions[:, None]
    couples = np.array([*combinations(range(8), 2)])
    middles = (around[:, couples[:, 0]] + around[:, couples[:, 1]]) / 2
    opposite = np.hypot(middles[..., 0], middles[..., 1]) < OPPOSITE_PITCHES * array.pitch
    first = np.argsort(~opposite, axis=1, kind="stable")[:, :4]
    taxels = np.arange(array.size)[:, None]
    pairs = np.where(opposite[taxels, first][..., None], neighbours[taxels[..., None], couples[first]], array.size)
    return np.ascontiguousarray(pairs.T)
