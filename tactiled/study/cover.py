"""How far the finite elements are from the exact gain over random stacks, and how long covers take to solve."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from tactiled.cover import fem, layered
from tactiled.cover.kernel import cached, solve
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError

PAPER = Stack((Layer(0.2, 98.0, 0.3), Layer(1.0, 980.0, 0.3)))
TIMES = 9  # of every timing, of which the median counts


@dataclass(frozen=True, slots=True)
class Trial:
    """One stack of the sweep, solved both ways."""

    stack: Stack
    error: float  # worst |G_fem - G_exact| where |G| is 1e-3 or more; NaN where the elements refuse the stack
    estimate: float
    unknowns: int
    seconds: float
    refusal: str = ""

    @property
    def ratio(self) -> float:
        """True error over its estimate."""
        return self.error / self.estimate


@dataclass(frozen=True, slots=True)
class Times:
    """What the paper's cover takes, s."""

    first: float  # by finite elements, the first cover that the process solves
    cold: float  # by finite elements
    warm: float  # from the cache
    exact: float  # exact gain at 256 frequencies


def random_stack(rng: np.random.Generator) -> Stack:
    """Draw one to four bonded layers and a sensing plane: thickness and modulus even in their logarithm.

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


def sweep(count: int, seed: int, accuracy: float = 1e-3) -> Iterator[Trial]:
    """Solve `count` random stacks, one after the other."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield trial(random_stack(rng), accuracy)


def trial(stack: Stack, accuracy: float = 1e-3) -> Trial:
    """Hold the gain that the finite elements give to a stack against the exact one."""
    start = perf_counter()
    try:
        kernel = solve(stack, "fem", accuracy)
    except PhysicsError as refusal:
        return Trial(stack, np.nan, np.nan, 0, perf_counter() - start, str(refusal))
    seconds = perf_counter() - start
    q = np.geomspace(kernel.q[1], kernel.q[-1], 3000)
    exact = layered.gain(stack, q)
    error = float(np.abs(kernel.gain_at(q) - exact)[np.abs(exact) >= fem.FLOOR].max())
    return Trial(stack, error, kernel.error_estimate, kernel.unknowns, seconds)


def times() -> Times:
    """Time the paper's cover."""
    first = _seconds(lambda: solve(PAPER))
    q = np.linspace(0, 8, 256)
    with TemporaryDirectory() as name:
        folder = Path(name)
        cached(PAPER, folder=folder)
        warm = _median(lambda: cached(PAPER, folder=folder))
    return Times(first, _median(lambda: solve(PAPER)), warm, _median(lambda: layered.gain(PAPER, q)))


def _median(work: Callable[[], object]) -> float:
    return median(_seconds(work) for _ in range(TIMES))


def _seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start
