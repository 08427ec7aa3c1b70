"""Whether the taxels lie where the map says: under a finger that rolls, neighbours in space are so in time, too.

The frames of a right map are smoother across neighbours than those of any wrong one. A map that is mirrored as a
whole is as smooth; only the known direction of a roll shows it.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tactiled.geometry import Array

Direction = Literal["right", "down"]

EDGE_PITCHES = 1.1  # distance of neighbours that are compared
PRESSED_SIGMAS, PRESSED_PART = 8.0, 0.05  # noise standard deviations and part of the peak of a pressed taxel
MIN_PRESSED = 0.7  # of the taxels: with fewer the roll says too little
SMOOTHER = 0.7  # of the configured map's roughness: another map is right
SWAPPED = 0.85  # of two taxels' own roughness: they are swapped; of neighbours under t/pitch 0.3 it is 0.82
MAX_SWAPS = 16

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


class MapVerdict(NamedTuple):
    """What a roll says of the map; `text` is for people."""

    text: str
    order: Indices | None = None  # (N,) the taxel that lies at each place; None: cannot tell
    swaps: tuple[tuple[int, int], ...] = ()


def check_map(pressure: Floats, array: Array, noise: float, direction: Direction | None = None) -> MapVerdict:
    """Judge the map of an array by pressures (T, N) while a finger rolls over it; `direction`: of one roll."""
    peak = np.nanmax(pressure, axis=0)
    pressed = peak > max(PRESSED_SIGMAS * noise, PRESSED_PART * float(peak.max()))
    if pressed.mean() < MIN_PRESSED:
        return MapVerdict(f"cannot tell: {np.mean(pressed):.0%} of the taxels were pressed: roll over all of them")
    frames = np.nan_to_num(pressure)
    alike = pressed * frames / np.sqrt(np.maximum(np.square(frames).mean(axis=0), noise**2))  # whatever the gains
    moments, edges = alike.T @ alike, _edges(array)
    scores = {name: _roughness(moments, edges, order) for name, order in _maps(array).items()}
    smoothest = min(scores, key=lambda name: scores[name])
    name = smoothest if scores[smoothest] < SMOOTHER * scores["as configured"] else "as configured"
    order = _maps(array)[name].copy()
    swaps = _swaps(moments, edges, order)
    texts = [name] if name != "as configured" else []
    if direction and (turned := _turned(frames[:, order], array, direction)):
        texts.append(turned)
    texts += [f"taxels {a} and {b} swapped" for a, b in swaps]
    return MapVerdict(", ".join(texts) or "as configured", order, swaps)


def _edges(array: Array) -> NDArray[np.bool_]:
    """(N, N) places that are neighbours."""
    pairs = cKDTree(array.positions).query_pairs(EDGE_PITCHES * array.pitch, output_type="ndarray")
    edges = np.zeros((array.size, array.size), bool)
    edges[pairs[:, 0], pairs[:, 1]] = edges[pairs[:, 1], pairs[:, 0]] = True
    return edges


def _maps(array: Array) -> dict[str, Indices]:
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


def _roughness(moments: Floats, edges: NDArray[np.bool_], order: Indices) -> float:
    """Mean square difference of neighbours over that of the readings."""
    placed = moments[np.ix_(order, order)]
    power = np.diag(placed)
    return float((edges * (power[:, None] + power - 2 * placed)).sum() / (edges.sum(axis=0) * power).sum())


def _swaps(moments: Floats, edges: NDArray[np.bool_], order: Indices) -> tuple[tuple[int, int], ...]:
    """Swap in `order` what lies at two places, as long as it makes both much smoother; gives the taxels."""
    swaps = []
    for _ in range(MAX_SWAPS):
        placed = moments[np.ix_(order, order)]
        power, degree = np.diag(placed), edges.sum(axis=0)
        # cost[i, p]: the taxel that lies at i, were it at p, against the neighbours of p
        cost = degree * power[:, None] + edges @ power - 2 * placed @ edges
        own, between = np.diag(cost), edges * (power[:, None] + power - 2 * placed)
        before, after = own[:, None] + own - 2 * between, cost + cost.T  # without what is between the two
        gain = np.where(after < SWAPPED * before, before - after, 0)
        a, b = np.unravel_index(gain.argmax(), gain.shape)
        if not gain[a, b]:
            break
        swaps.append((int(min(order[a], order[b])), int(max(order[a], order[b]))))
        order[[a, b]] = order[[b, a]]
    return tuple(swaps)


def _turned(frames: Floats, array: Array, direction: Direction) -> str:
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
