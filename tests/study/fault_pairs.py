"""Two faults at once: every pair of the worst, each at two strengths, and whether it is noticed."""

from itertools import combinations, product
from typing import NamedTuple

from tactiled.cli.bench import Reduced, print_lines, print_table
from tactiled.study.faults import cases
from tactiled.study.results import machine
from tactiled.study.stability import WORSE, curve, restore, setting

FAULTS = {  # mild and bad, in the unit of the sweep
    "thickness wrong": (-20, 20),
    "modulus wrong": (-30, 30),
    "white noise": (3, 10),
    "correlated noise": (2, 10),
    "offset": (-5, 5),
    "dead taxels unflagged": (1, 5),
    "saturation unflagged": (80, 60),
}
METHODS = ("auto", "wiener", "nnls", "tv", "rl", "skimage wiener", "skimage rl")
HEADINGS = ("together", *METHODS, "auto worse than raw", "of these noticed")


class Pair(NamedTuple):
    name: str
    over_raw: dict[str, float]  # by method: mean error of the scenes over the raw image's
    noticed: list[bool]  # of each image of auto that is worse than raw
    scenes: int


def measure(setting, bad_only):
    """Every pair of faults, at both strengths of both, or at the bad ones only."""
    for pair in combinations(FAULTS, 2):
        for values in product(*(FAULTS[name][bad_only:] for name in pair)):
            faults = dict(zip(pair, values, strict=True))
            name = " with ".join(f"{fault} {value:g} %" for fault, value in faults.items())
            rows = [row for case in cases(setting, faults) for row in restore(name, 0, case)]
            auto = [row for row in rows if row.method == "auto"]
            ratios = {method: curve(rows, method)[0] for method in METHODS}
            yield Pair(name, ratios, [row.noticed for row in auto if row.failed], len(auto))


def fault_pairs(reduced: Reduced = False, seed: int = 1) -> None:
    """Restore frames with every pair of faults; print the ten that hurt auto most."""
    pairs = sorted(measure(setting(reduced, seed)[0], reduced), key=lambda pair: -pair.over_raw["auto"])
    table = [
        (pair.name, *(f"{pair.over_raw[name]:.2f}" for name in METHODS), f"{len(pair.noticed)} of {pair.scenes}",
         str(sum(pair.noticed)))
        for pair in pairs[:10]
    ]  # fmt: skip
    print_table("Error over the raw image's", HEADINGS, table)
    broken = sum(pair.over_raw["auto"] > WORSE for pair in pairs)
    failed, noticed = (sum(map(count, (pair.noticed for pair in pairs))) for count in (len, sum))
    print_lines(f"{broken} of {len(pairs)} pairs make auto worse than raw in the mean; {noticed} of the {failed}")
    print_lines("single images that are worse are noticed.", machine())
