"""Error over the raw image's as things go wrong, a panel for each; and claimed against true deviation."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from tactiled.study.charts import COLOURS, figure
from tactiled.study.stability import HONEST, Row, curve
from tactiled.study.sweeps import Sweep

BLUE, RED, GREEN, PINK, BLACK, SKY = COLOURS
STYLES = {  # method -> label, colour, mark, dashes
    "auto": ("auto", BLACK, "*", "-"),
    "wiener": ("wiener", BLUE, "o", "-"),
    "nnls": ("nnls", GREEN, "^", "-"),
    "tv": ("tv", GREEN, "d", (0, (1, 1))),
    "points": ("points", PINK, "v", "-"),
    "rl": ("rl", RED, "s", "-"),
    "rl-fast": ("rl-fast", SKY, "P", "-"),
    "skimage wiener": ("scikit-image wiener", BLUE, "", (0, (3, 2))),
    "skimage rl": ("scikit-image richardson_lucy", RED, "", (0, (3, 2))),
}
TOP = 2.0  # times the raw image's error: more is drawn at the edge
COLUMNS = 3
Found = Sequence[tuple[Sweep, list[Row]]]


def draw(path: Path, found: Found, over: str = "raw", only: tuple[str, ...] = ()) -> None:
    """Draw every sweep, or those named, into `path`: error over that of `over`."""
    shown = [(sweep, rows) for sweep, rows in found if not only or sweep.name in only]
    count = -(-len(shown) // COLUMNS)
    with figure(path, 10, 0.9 + 2.25 * count) as drawn:
        grid = drawn.subplots(count, COLUMNS, sharey=True, squeeze=False)
        for axes, (sweep, rows) in zip(grid.flat, shown, strict=False):
            _sweep(axes, sweep, rows, over)
        for axes in grid.flat[len(shown) :]:
            axes.set_visible(False)
        whose = "raw image's" if over == "raw" else f"{over}'s"
        drawn.supylabel(f"error over the {whose}", fontsize=11)
        lines = [
            Line2D(
                [],
                [],
                color=colour,
                marker=mark,
                ls=dashes,
                mfc="white" if name == "nnls" else colour,
                ms=8 if name in ("auto", "nnls") else 4.5,
                lw=1.4,
                label=label,
            )
            for name, (label, colour, mark, dashes) in STYLES.items()
            if name != over
        ]
        lines.append(Line2D([], [], color="#F0D0BC", lw=8, label=f"worse than {'raw' if over == 'raw' else over}"))
        drawn.legend(handles=lines, loc="outside lower center", ncols=4, fontsize=9.5)


def _sweep(axes: Axes, sweep: Sweep, rows: list[Row], over: str) -> None:
    values = sorted({row.value for row in rows})
    at = np.arange(len(values), dtype=float)
    present = {row.method for row in rows}
    axes.axhspan(1, TOP * 1.05, color="#FBEEE6", lw=0, zorder=0)
    axes.axvline(values.index(sweep.harmless), color="#bbbbbb", lw=1, ls=":", zorder=1)
    for name, (_, colour, mark, dashes) in STYLES.items():
        if name not in present or name == over:
            continue
        ratios = curve(rows, name, over)
        y = np.minimum([ratios[value] for value in values], TOP)
        front = name in ("auto", "nnls")
        axes.plot(
            at,
            y,
            color=colour,
            ls=dashes,
            marker=mark,
            lw=1.3,
            ms=8 if front else 3.5,
            mfc="white" if name == "nnls" else colour,
            mew=0.9,
            zorder=4 if name == "auto" else 3,
        )
    axes.set_title(sweep.name.capitalize(), fontsize=11)
    axes.set_xlabel(sweep.unit, fontsize=9.5, labelpad=3)
    axes.set(ylim=(0, TOP * 1.05), xlim=(-0.3, len(values) - 0.7))
    axes.set_xticks(at, [f"{value:g}".replace("-", "−") for value in values], fontsize=8.5)


def calibration(path: Path, found: Found, method: str = "auto") -> None:
    """Draw the deviation that a method claims against its true error, a mark an image, filled if it was warned."""
    with figure(path, 10, 5.6) as drawn:
        left, right = drawn.subplots(1, 2, sharey=True, sharex=True)
        _claims(left, "Restoration knows what goes wrong", [one for one in found if one[0].told], method)
        _claims(right, "Nobody told it", [one for one in found if not one[0].told], method)
        left.set_ylabel("true error (kPa, root mean square)")
        left.text(0.13, 60, f"more than {1 / HONEST:g} times as wrong as claimed", fontsize=9, color="#7d3600")


def _claims(axes: Axes, title: str, found: Found, method: str) -> None:
    for number, (sweep, all_) in enumerate(found):
        rows = [row for row in all_ if row.method == method and row.claimed > 0]
        colour, mark = COLOURS[number % len(COLOURS)], "os^DvPX*<>h"[number % 11]
        style: dict[str, Any] = {"color": colour, "marker": mark, "ls": "", "ms": 5, "mew": 0.9}
        for warned in (True, False):
            some = [row for row in rows if (row.flagged or bool(row.warned)) is warned]
            claimed, error = [row.claimed for row in some], [row.error for row in some]
            axes.plot(claimed, error, mfc=colour if warned else "none", alpha=0.45 if warned else 1, **style)
        axes.plot([], [], mfc="none", label=sweep.name, **style)
    low, high = 0.02, 200.0
    axes.fill_between([low, high], [low / HONEST, high / HONEST], [1e3, 1e3], color="#FBEEE6", lw=0, zorder=0)
    axes.plot([low, high], [low, high], color="#444444", lw=1)
    axes.set(xscale="log", yscale="log", xlim=(0.1, 100), ylim=(0.1, 100), title=title)
    axes.set_xlabel("claimed standard deviation (kPa, of 100)")
    axes.plot([], [], "o", color="#444444", alpha=0.45, label="filled: warned")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8.5, ncols=3, handletextpad=0.1)
