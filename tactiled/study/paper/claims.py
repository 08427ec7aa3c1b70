"""What a statement of the paper is, and how both models are held against it."""

from collections.abc import Callable
from dataclasses import dataclass

from tactiled.study.paper.cases import Which

BOTH: tuple[Which, Which] = ("fem", "exact")
ROUNDING = 0.05  # the paper gives its gains to one digit


@dataclass(frozen=True, slots=True)
class Claim:
    """One statement held against both models."""

    where: str
    states: str
    fem: str
    exact: str
    agrees: bool | None  # None where the paper gives nothing to hold against
    why: str


def told(measure: Callable[[Which], float], form: str = "{:.3f}") -> tuple[str, str]:
    """Measure what finite elements and the exact solution make of a number, as text."""
    return form.format(measure("fem")), form.format(measure("exact"))
