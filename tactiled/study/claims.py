"""How far the deviation that is claimed for an image of `auto` falls short, where it is worse than raw."""

from collections.abc import Sequence

import numpy as np

from tactiled.study.pairs import Pair
from tactiled.study.stability import HONEST, WORSE, Found, Row, noticed

HEADINGS = (
    "goes wrong",
    "images worse than raw",
    "true error over claimed: median",
    "at most",
    f"over {1 / HONEST:g}",
    "of these with a warning",
)


def lines(found: Found, together: Sequence[Pair]) -> list[tuple[str, ...]]:
    """A table by HEADINGS: every fault that makes an image worse, then all pairs of faults."""
    every = [(sweep.name, rows) for sweep, rows in found]
    every.append(("two at once", [row for pair in together for row in pair.rows]))
    failed = [
        (name, [row for row in rows if row.method == "auto" and row.over_raw > WORSE]) for name, rows in every
    ]
    return [_line(name, rows) for name, rows in failed if rows]


def _line(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    ratios = np.array([row.error / row.claimed if row.claimed else np.inf for row in rows])
    short = [row for row in rows if row.claimed < HONEST * row.error]
    warned = f"{sum(noticed(row) for row in short)} of {len(short)}" if short else "–"
    return name, str(len(rows)), f"{np.median(ratios):.1f}", f"{ratios.max():.1f}", str(len(short)), warned
