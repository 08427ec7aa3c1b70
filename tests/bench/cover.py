"""How far the finite elements are from the exact gain over random stacks, and how long covers take to solve."""

from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import NamedTuple

import numpy as np

from tactiled.bench.results import machine
from tactiled.cli.bench import print_table
from tactiled.cover import fem, layered
from tactiled.cover.kernel import cached, solve
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError

PAPER = Stack((Layer(0.2, 98.0, 0.3), Layer(1.0, 980.0, 0.3)))
REPEATS = 9  # of every timing, of which the median counts


class Trial(NamedTuple):
    """One stack, solved both ways."""

    stack: Stack
    seconds: float
    error: float = np.nan  # worst |G_fem - G_exact| where |G| is 1e-3 or more; NaN where the elements refuse
    ratio: float = np.nan  # of the error to its estimate
    unknowns: int = 0
    refusal: str = ""


def random_stack(rng):
    """One to four bonded layers and a sensing plane: thickness and modulus even in their logarithm.

    The lowest of several layers is what the others cover. Half of all layers are rubber of 0.49 to 0.4999.
    """
    count = int(rng.integers(1, 5))
    thickness = 10 ** rng.uniform(np.log10(0.05), 1, count)
    young = 10 ** rng.uniform(np.log10(0.05), 4, count)
    if count > 1:
        young[-1] = 10 ** rng.uniform(0, np.log10(200_000))
    rubber = rng.random(count) < 0.5
    poisson = np.where(rubber, 0.5 - 10 ** rng.uniform(-4, -2, count), rng.uniform(0, 0.4999, count))
    layers = (Layer(*map(float, one)) for one in zip(thickness, young, poisson, strict=True))
    return Stack(tuple(layers), sensing=int(rng.integers(1, count + 1)))


def trial(stack):
    """Compare the gain that the finite elements give to a stack with the exact one."""
    start = perf_counter()
    try:
        kernel = solve(stack, "fem", 1e-3)
    except PhysicsError as refusal:
        return Trial(stack, perf_counter() - start, refusal=str(refusal))
    seconds = perf_counter() - start
    q = np.geomspace(kernel.q[1], kernel.q[-1], 3000)
    exact = layered.gain(stack, q)
    error = float(np.abs(kernel.gain_at(q) - exact)[np.abs(exact) >= fem.FLOOR].max())
    return Trial(stack, seconds, error, error / kernel.error_estimate, kernel.unknowns)


def times_s():
    """Seconds for the paper's cover: the process's first, others, from the cache; exact at 256 frequencies."""
    first = _seconds(lambda: solve(PAPER))
    q = np.linspace(0, 8, 256)
    with TemporaryDirectory() as folder:
        timed = (lambda: solve(PAPER), lambda: cached(PAPER, folder=Path(folder)), lambda: layered.gain(PAPER, q))
        return first, *(median(_seconds(work) for _ in range(REPEATS)) for work in timed)


def _seconds(work):
    start = perf_counter()
    work()
    return perf_counter() - start


def sweep(count, seed):
    rng = np.random.default_rng(seed)
    return [trial(random_stack(rng)) for _ in range(count)]


def cover(stacks: int = 200, seed: int = 1) -> None:
    """Compare finite elements with the exact gain of random stacks, and time the paper's cover, on one core."""
    first, cold, warm, exact = (f"{1e3 * each:.3g}" for each in times_s())
    trials = sweep(stacks, seed)
    solved = [each for each in trials if not each.refusal]
    seconds = sorted(each.seconds for each in trials)
    rows = [
        ("worst |G_fem − G_exact| where G ≥ 1e-3", f"{max(each.error for each in solved):.1e}", "1e-3 or less"),
        ("worst true error / estimate", f"{max(each.ratio for each in solved):.2f}", "2 or less"),
        ("refused with an error", f"{len(trials) - len(solved)}", "0"),
        ("a random stack, median / longest", f"{median(seconds):.2f} / {seconds[-1]:.2f} s", ""),
        ("the paper's cover, first / median", f"{first} / {cold} ms", "under 300 ms"),
        ("the paper's cover, from cache", f"{warm} ms", "under 5 ms"),
        ("exact gain, 256 frequencies, two layers", f"{exact} ms", "under 5 ms"),
    ]
    print_table(f"Covers at 1e-3, {stacks} random stacks", ("figure", "measured", "aim"), rows)
    worst = max(solved, key=lambda each: each.error)
    print(f"Worst error: {worst.stack}; {worst.unknowns} unknowns.")
    print(*(f"Refused: {each.stack}: {each.refusal}." for each in trials if each.refusal), machine(), sep="\n")
