"""Whether the taxels lie where the map says: under a contact that moves, neighbours in space are so in time, too.

The frames of a right map are smoother across neighbours than those of any wrong one. A map that is mirrored as a
whole is as smooth; only the known direction of a roll shows it.
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement
from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tactiled.arrays import Ints, Mask, Reals
from tactiled.geometry import Array

Direction = Literal["right", "down"]

EDGE_PITCHES = 1.1  # distance of neighbours that are compared
PRESSED_SIGMAS, PRESSED_PART = 8.0, 0.05  # noise standard deviations and part of the peak of a pressed taxel
MIN_PRESSED = 0.7  # of the taxels: with fewer the roll says too little
SMOOTHER = 0.7  # times the configured map's roughness: a map below that is right instead
SEAM = 0.5  # times the roughness at a block's seams: with less after a swap or a reversal, that is the fault
SWAPPED = 0.85  # times two taxels' roughness: with less they are swapped; neighbours have 0.82 at t/pitch 0.3
MIN_ROUGH = 0.1  # of a place that may be wrong: under even pressure taxels differ only by noise
MAX_SWAPS, MAX_BLOCK_SWAPS = 16, 4
SUSPECTS, SUSPECT_BLOCKS = 64, 8  # the roughest taxels, and blocks of each size: swaps are sought among them
MAX_BLOCKS, MIN_BLOCK = 64, 4  # connectors of an array, and taxels of one


class MapVerdict(NamedTuple):
    """What a roll says of the map."""

    texts: tuple[str, ...]  # for people: what is wrong, or why it cannot be told
    order: Ints | None = None  # (N,) the taxel that lies at each place; None: cannot tell
    swaps: tuple[tuple[int, int], ...] = ()

    @property
    def text(self) -> str:
        """In a line."""
        return ", ".join(self.texts) or "as configured"


def check_map(
    pressure: Reals,
    array: Array,
    noise: float | Reals,
    direction: Direction | None = None,
    min_pressed: float = MIN_PRESSED,
    swapped: float = SWAPPED,
    rough_seams: float = MIN_ROUGH,
) -> MapVerdict:
    """Judge the map of an array by pressures (T, N) while a finger rolls over it; `direction`: of one roll.

    Blocks are wrong only where their seams are rougher than `rough_seams`.
    """
    frames = np.nan_to_num(pressure).astype(np.float32)
    peak = frames.max(axis=0)
    pressed = peak > np.maximum(PRESSED_SIGMAS * noise, PRESSED_PART * float(peak.max()))
    if pressed.mean() < min_pressed:
        share = f"{np.mean(pressed):.0%} of the taxels were pressed"
        return MapVerdict((f"cannot tell: {share}: roll over all of them",))
    power = np.square(frames).mean(axis=0)
    alike = frames / np.sqrt(np.maximum(power, np.square(noise)), dtype=np.float32)  # whatever the gains
    roll = _Roll.of(alike, pressed, array)
    maps = _maps(array)
    scores = {name: roll.roughness(*order[roll.pairs]) for name, order in maps.items()}
    smoothest = min(scores, key=lambda name: scores[name])
    name = smoothest if scores[smoothest] < SMOOTHER * scores["as configured"] else "as configured"
    order = maps[name].copy()
    texts = [name] if name != "as configured" else []
    texts += _swapped_blocks(roll, array, order, rough_seams)
    swaps = _swaps(roll, order, swapped)
    if direction and (turned := _turned(frames[:, order], array, direction)):
        texts.append(turned)
    return MapVerdict((*texts, *(f"taxels {a} and {b} swapped" for a, b in swaps)), order, swaps)


class _Roll(NamedTuple):
    """How alike taxels felt it."""

    pressed: Mask  # (N,) the others say nothing
    power: Reals  # (N,) of their readings
    squares: Reals  # (N, N) of the difference of any two
    pairs: Ints  # (2, E) places that are neighbours

    @classmethod
    def of(cls, alike: Reals, pressed: Mask, array: Array) -> "_Roll":
        """From readings (T, N) of about the same strength."""
        pairs = cKDTree(array.positions).query_pairs(EDGE_PITCHES * array.pitch, output_type="ndarray")
        moments = alike.T @ alike
        power = np.diag(moments)
        return cls(pressed, power, power[:, None] + power - 2 * moments, np.asarray(pairs.T))

    def roughness(self, a: Ints, b: Ints) -> float:
        """Mean square difference of taxels (E,) over that of the readings."""
        both = self.pressed[a] & self.pressed[b]
        a, b = a[both], b[both]
        return float(self.squares[a, b].sum() / max((self.power[a] + self.power[b]).sum(), 1e-9))

    def of_places(self, order: Ints) -> Reals:
        """Roughness (N,) of each place against its neighbours."""
        (a, b), n = order[self.pairs], len(order)
        both = self.pressed[a] & self.pressed[b]
        values = both * self.squares[a, b], both * (self.power[a] + self.power[b])
        rough, scale = (sum(np.bincount(side, each, n) for side in self.pairs) for each in values)
        return np.asarray(rough / np.maximum(scale, 1e-9))


def _maps(array: Array) -> dict[str, Ints]:
    """The taxel at each place (N,) of the maps that are often meant."""
    order = np.arange(array.size)
    maps = {"as configured": order}
    if array.shape is not None:
        rows, columns = array.shape
        table = order.reshape(array.shape)
        maps["every other row mirrored"] = np.where(np.arange(rows)[:, None] % 2, table[:, ::-1], table).ravel()
        maps["every other column mirrored"] = np.where(np.arange(columns) % 2, table[::-1], table).ravel()
        if rows != columns:  # else it is as smooth as the configured one
            maps["rows and columns transposed"] = order.reshape(columns, rows).T.ravel()
    return maps


def _blocks(array: Array) -> Iterator[tuple[str, Ints]]:
    """Name and taxels (blocks, n) of what may share a connector: runs of the messages, rows, columns."""
    order, columns = np.arange(array.size), array.shape[1] if array.shape else 0
    for count in range(2, min(MAX_BLOCKS, array.size // MIN_BLOCK) + 1):
        if array.size % count == 0:
            yield "row" if array.size == count * columns else "taxels", order.reshape(count, -1)
    if 1 < columns <= min(MAX_BLOCKS, array.size // MIN_BLOCK):
        yield "column", order.reshape(-1, columns).T


def _swapped_blocks(roll: _Roll, array: Array, order: Ints, rough_seams: float) -> list[str]:
    """Swap in `order` blocks, or reverse them, as long as it makes their seams much smoother; says which."""
    texts: list[str] = []
    while len(texts) < MAX_BLOCK_SWAPS:
        rough = roll.of_places(order)
        gain, text, other = 0.0, "", order
        for name, blocks in _blocks(array):
            suspects = np.argsort(rough[blocks].mean(axis=1))[-SUSPECT_BLOCKS:]
            for a, b in combinations_with_replacement(sorted(suspects.tolist()), 2):
                tried = order.copy()
                tried[blocks[a]], tried[blocks[b]] = order[blocks[b]], order[blocks[a]]
                if a == b:
                    tried[blocks[a]] = order[blocks[a][::-1]]
                if (smoother := _smoother(roll, order, tried, rough_seams)) > gain:
                    gain, text, other = smoother, _block_text(name, blocks, a, b), tried
        if not text:
            break
        texts.append(text)
        order[:] = other
    return texts


def _smoother(roll: _Roll, order: Ints, other: Ints, rough_seams: float) -> float:
    """By how much another order is smoother where it differs; 0 unless it is much and the seams are so rough."""
    now, then = np.sort(order[roll.pairs], axis=0), np.sort(other[roll.pairs], axis=0)
    changed = (now != then).any(axis=0)
    before, after = roll.roughness(*now[:, changed]), roll.roughness(*then[:, changed])
    if after >= SEAM * before:
        return 0.0
    ends = np.array([[len(order)], [1]])
    seams = ~np.isin((now * ends).sum(axis=0), (then * ends).sum(axis=0))  # other pairs are within a block
    return (before - after) * float(changed.sum()) if roll.roughness(*now[:, seams]) > rough_seams else 0.0


def _block_text(name: str, blocks: Ints, a: int, b: int) -> str:
    """What is wrong with two blocks, or with one, in words."""
    texts = [
        f"{name} {at}" if name != "taxels" else f"taxels {blocks[at][0]} to {blocks[at][-1]}" for at in (a, b)
    ]
    return f"{texts[0]} in reverse order" if a == b else f"{texts[0]} and {texts[1]} swapped"


def _swaps(roll: _Roll, order: Ints, swapped: float) -> tuple[tuple[int, int], ...]:
    """Swap in `order` what lies at two places, as long as it makes both much smoother; gives the taxels."""
    swaps: list[tuple[int, int]] = []
    while len(swaps) < MAX_SWAPS:
        rough = roll.of_places(order)
        suspects = np.argsort(rough)[-SUSPECTS:]
        suspects = suspects[rough[suspects] > MIN_ROUGH]
        gain = _swap_gains(roll, order, suspects, swapped)
        if not gain.any():
            break
        at = suspects[list(np.unravel_index(gain.argmax(), gain.shape))]
        a, b = sorted(order[at].tolist())
        if (a, b) in swaps:  # back again: they are alike
            break
        swaps.append((a, b))
        order[at] = order[at[::-1]]
    return tuple(swaps)


def _swap_gains(roll: _Roll, order: Ints, suspects: Ints, swapped: float) -> Reals:
    """By how much smoother both are (K, K) if what lies at two of K places is swapped; 0 unless much smoother."""
    n, (a, b) = len(order), roll.pairs
    both = roll.pressed[order[a]] & roll.pressed[order[b]]
    half = csr_array((both.astype(np.float32), (a, b)), shape=(n, n))
    near = (half + half.T)[suspects]
    squares = roll.squares[order[suspects]][:, order]
    cost = (near @ squares.T).T  # [i, p]: the taxel that lies at i, were it at p, against the neighbours of p
    now = np.diag(cost)
    before = now[:, None] + now - 2 * near[:, suspects].toarray() * squares[:, suspects]  # without that between
    after = cost + cost.T
    return np.where(after < swapped * before, before - after, 0)


def _turned(frames: Reals, array: Array, direction: Direction) -> str:
    """How the map is turned if the contact moves otherwise than in `direction`; "" if it does not."""
    force = frames.clip(0).sum(axis=1)
    lies = force > PRESSED_PART * force.max()
    centre = frames[lies].clip(0) @ array.positions / force[lies, None]
    time = np.arange(len(centre)) - (len(centre) - 1) / 2
    along_x, along_y = time @ centre
    along, across = (along_x, along_y) if direction == "right" else (along_y, along_x)
    if abs(across) > abs(along):
        return "rows and columns transposed"
    return "" if along > 0 else "columns mirrored" if direction == "right" else "rows mirrored"
