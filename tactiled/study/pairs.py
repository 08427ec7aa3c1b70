"""Two things that go wrong at once: every pair of faults, each at two strengths, and whether it is noticed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy.ndimage import gaussian_filter

from tactiled.study.faults import CORRELATION, Case, Setting, noisy, scenes
from tactiled.study.skin import mistaken
from tactiled.study.stability import WORSE, Row, curve, noticed, rows
from tactiled.study.sweeps import Sweep

NOISE = 1.0  # % of the peak, where it is no fault
FAULTS: dict[str, tuple[float, float]] = {  # those that hurt alone, mild and bad
    "thickness": (-20, 20),  # % of the cover's true thickness over the one believed
    "modulus": (-30, 30),  # % of its true modulus over the one believed
    "noise": (3, 10),  # % of the peak, told
    "correlated": (2, 10),  # the same, that neighbours share
    "offset": (-5, 5),  # % of the peak
    "dead": (1, 5),  # % of the taxels, that read 0, untold
    "ceiling": (80, 60),  # % of the peak, untold
}
SHOWN = ("auto", "wiener", "nnls", "tv", "rl", "skimage wiener", "skimage rl")


@dataclass(frozen=True, slots=True)
class Pair:
    """Two faults at one strength each, and what every method made of it."""

    faults: dict[str, float]
    over_raw: dict[str, float]  # by method: mean error of the scenes over the raw image's
    scenes: int
    failed: int  # scenes where auto is worse than raw
    noticed: int  # of those
    rows: tuple[Row, ...]


def measure(setting: Setting, quick: bool) -> Iterator[Pair]:
    """Every pair of faults, at both strengths of both, or at the bad ones only."""
    for pair in combinations(FAULTS, 2):
        strengths = [FAULTS[name][1:] if quick else FAULTS[name] for name in pair]
        for values in product(*strengths):
            yield _pair(setting, dict(zip(pair, values, strict=True)))


def count(quick: bool) -> int:
    """How many pairs `measure` gives."""
    return len(FAULTS) * (len(FAULTS) - 1) // 2 * (1 if quick else 4)


def _pair(setting: Setting, faults: dict[str, float]) -> Pair:
    sweep = Sweep(name(faults), "", (0,), 0, lambda _, one: combined(one, faults), told=False)
    found = [row for case in sweep.make(0, setting) for row in rows(sweep, 0, case)]
    failed = [row for row in found if row.method == "auto" and row.over_raw > WORSE]
    methods = list(dict.fromkeys(row.method for row in found))
    return Pair(
        faults=faults,
        over_raw={method: curve(found, method)[0] for method in methods},
        scenes=sum(row.method == "auto" for row in found),
        failed=len(failed),
        noticed=sum(noticed(row) for row in failed),
        rows=tuple(found),
    )


def name(faults: dict[str, float]) -> str:
    """Both faults and their strengths."""
    return " with ".join(f"{fault} {value:g} %" for fault, value in faults.items()).replace("-", "−")


def combined(setting: Setting, faults: dict[str, float]) -> Iterator[Case]:
    """Frames with all of `faults`; their noise is told, white and correlated together."""
    changed = {
        key: 1 + faults.get(fault, 0) / 100 for key, fault in (("thickness", "thickness"), ("young", "modulus"))
    }
    skin = mistaken(setting.skin, **changed)
    for scene, clean, truth, random in scenes(skin, setting):
        peak = float(clean.max())
        frame, sigma = noisy(clean, faults.get("noise", NOISE) / 100, random)
        if "correlated" in faults:
            smooth = gaussian_filter(random.normal(0, 1, clean.shape), CORRELATION, mode="wrap")
            shared = faults["correlated"] / 100 * peak
            frame = (frame + shared * smooth / smooth.std()).astype(np.float32)
            sigma = float(np.hypot(sigma, shared))
        frame = frame + np.float32(faults.get("offset", 0) / 100 * peak)
        frame = np.minimum(frame, np.float32(faults.get("ceiling", np.inf) / 100 * peak))
        gone = random.permutation(frame.size).reshape(frame.shape) < round(
            faults.get("dead", 0) / 100 * frame.size
        )
        yield Case(scene, skin, np.where(gone, np.float32(0), frame), truth, sigma)


HEADINGS = ("together", *(f"{method} over raw" for method in SHOWN), "auto worse than raw", "of these noticed")


def worst(found: Sequence[Pair], most: int) -> list[Pair]:
    """Those that hurt `auto` most."""
    return sorted(found, key=lambda pair: -pair.over_raw["auto"])[:most]


def lines(found: Sequence[Pair]) -> list[tuple[str, ...]]:
    """A table of pairs, by HEADINGS."""
    return [
        (
            name(pair.faults),
            *(f"{pair.over_raw[method]:.2f}" if method in pair.over_raw else "–" for method in SHOWN),
            f"{pair.failed} of {pair.scenes} scenes",
            str(pair.noticed) if pair.failed else "nothing to notice",
        )
        for pair in found
    ]


def verdict(found: Sequence[Pair]) -> str:
    """How many pairs break `auto`, and how many of its failures are noticed."""
    broken = [pair for pair in found if pair.over_raw["auto"] > WORSE]
    failed, seen = sum(pair.failed for pair in found), sum(pair.noticed for pair in found)
    return (
        f"{len(broken)} of {len(found)} pairs make auto's mean error worse than the raw image's; of the"
        f" {failed} single images that are worse, {seen} are noticed."
    )
