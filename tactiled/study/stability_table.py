"""The table of failures, to read."""

from collections.abc import Sequence

from tactiled.study.stability import OURS, THEIRS, Failure

HEADINGS = ("goes wrong", *OURS, *THEIRS, "auto at its worst", "noticed on auto", "by")


def lines(failures: Sequence[Failure]) -> list[tuple[str, ...]]:
    """The table to read, by HEADINGS: where each method is first worse than raw, and what `auto` says of it."""
    found = []
    for name in dict.fromkeys(one.sweep for one in failures):
        by = {one.method: one for one in failures if one.sweep == name}
        auto = by["auto"]
        at = [_values(by[method].breaks_at) if method in by else "" for method in (*OURS, *THEIRS)]
        worst = f"{auto.worst:.2f} at {auto.worst_at:g}"
        found.append((f"{name} ({auto.unit})", *at, worst, auto.noticed or "nothing to notice", auto.by))
    return [tuple(cell.replace("-", "−") if number else cell for number, cell in enumerate(row)) for row in found]


def _values(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:g}" for value in values) or "never"
