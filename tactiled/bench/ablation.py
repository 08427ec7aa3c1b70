"""What each rule of `auto` earns: its frames restored without it, in time and in error."""

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from tactiled.bench.skin import Film, Skin, films
from tactiled.restore.methods import make

RULES = {
    "idle": "a frame of noise is left empty",
    "raw": "a cover that hardly matters is left alone",
    "wiener": "a linear image that hardly falls below zero is kept",
    "memory": "the frame before is started from, and its method kept on the border",
}
ROUNDS = 3  # over which the least time of a frame counts


@dataclass(frozen=True, slots=True)
class Earned:
    """One rule, on the frames that it decided: as it is, and without it."""

    rule: str
    frames: int
    of: int
    time: float  # microseconds a frame, median
    time_without: float
    error: float  # root mean square over the noise of a taxel, mean
    error_without: float


def measure(skins: list[Skin], noises: tuple[float, ...], frames: int, seed: int) -> list[Earned]:
    """Play films, an idle one among them, to auto, to auto made to forget every frame, and to nnls.

    Without its rule a frame would go down auto's line to nnls, so that is what the rule is held against;
    without memory it is auto, reset before every frame.
    """
    told: dict[str, list[tuple[float, ...]]] = {rule: [] for rule in RULES}
    total = 0
    for film, skin in _films(skins, noises, frames, seed):
        chosen, *auto = _play(skin, film, "auto")
        _, *nnls = _play(skin, film, "nnls")
        _, *forgetful = _play(skin, film, "auto", forget=True)
        for n, method in enumerate(chosen):
            total += 1
            mine = auto[0][n], auto[1][n]
            if method in told:
                told[method].append((*mine, nnls[0][n], nnls[1][n]))
            if n:
                told["memory"].append((*mine, forgetful[0][n], forgetful[1][n]))
    return [_earned(rule, rows, total) for rule, rows in told.items() if rows]


def _earned(rule: str, rows: list[tuple[float, ...]], total: int) -> Earned:
    time, error, time_without, error_without = np.array(rows).T
    return Earned(
        rule=rule,
        frames=len(rows),
        of=total,
        time=float(np.median(time)),
        time_without=float(np.median(time_without)),
        error=float(error.mean()),
        error_without=float(error_without.mean()),
    )


def _films(skins: list[Skin], noises: tuple[float, ...], frames: int, seed: int) -> Iterator[tuple[Film, Skin]]:
    for skin in skins:
        for noise in noises:
            for film in films(skin, noise, frames, seed):
                yield film, skin
        random = np.random.default_rng([seed, 9])
        idle = random.normal(0, 1, (frames, *skin.array.frame_shape)).astype(np.float32)
        yield Film("idle", 1.0, idle, np.zeros(idle.shape)), skin


def _play(skin: Skin, film: Film, name: str, forget: bool = False) -> tuple[list[str], list[float], list[float]]:
    """The methods that ran, microseconds and error of every frame."""
    restorer = make(name, skin.blur, film.sigma)
    times = np.full(len(film.frames), np.inf)
    for _ in range(ROUNDS):
        restorer.reset()
        chosen, errors = [], []
        for n, (frame, truth) in enumerate(zip(film.frames, film.truths, strict=True)):
            if forget:
                restorer.reset()
            start = perf_counter()
            done = restorer(frame)
            times[n] = min(times[n], 1e6 * (perf_counter() - start))
            chosen.append(done.method)
            errors.append(float(np.sqrt(np.mean((done.image - truth) ** 2))) / film.sigma)
    return chosen, times.tolist(), errors
