"""Error over the raw image's as things go wrong, a panel for each; and stated against true deviation."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from tactiled.study.charts import COLOURS, OURS, WORSE_COLOUR, figure
from tactiled.study.faults import Sweep
from tactiled.study.stability import HONEST, Results, Row, curve

DASHES = {"tv": (0, (1, 1)), "skimage wiener": (0, (3, 2)), "skimage rl": (0, (3, 2))}
STYLES = {  # method -> label, mark, colour
    **{name: (name, *look) for name, look in OURS.items()},
    "skimage wiener": ("scikit-image wiener", "", COLOURS[0]),
    "skimage rl": ("scikit-image richardson_lucy", "", COLOURS[1]),
}
LARGE = ("auto", "nnls")  # auto often selects nnls, and then both must show
TOP = 2.0  # times the raw image's error: more is drawn at the edge
COLUMNS = 3


def draw(path: Path, results: Results) -> None:
    """Draw every sweep into `path`: error over the raw image's."""
    count = -(-len(results) // COLUMNS)
    with figure(path, 10, 0.9 + 2.25 * count) as chart:
        grid = chart.subplots(count, COLUMNS, sharey=True, squeeze=False)
        for axes, (sweep, rows) in zip(grid.flat, results, strict=False):
            _sweep(axes, sweep, rows)
        for axes in grid.flat[len(results) :]:
            axes.set_visible(False)
        chart.supylabel("error over the raw image's", fontsize=11)
        handles = [
            Line2D([], [], ms=8 if name in LARGE else 4.5, lw=1.4, label=STYLES[name][0], **_look(name))
            for name in STYLES
        ]
        handles.append(Line2D([], [], color="#F0D0BC", lw=8, label="worse than raw"))
        chart.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=9.5)


def _look(name: str) -> dict[str, Any]:
    _, mark, colour = STYLES[name]
    fill = "white" if name == "nnls" else colour
    return {"color": colour, "marker": mark, "ls": DASHES.get(name, "-"), "mfc": fill}


def _sweep(axes: Axes, sweep: Sweep, rows: list[Row]) -> None:
    values = sorted({row.value for row in rows})
    at = np.arange(len(values), dtype=float)
    axes.axhspan(1, TOP * 1.05, color=WORSE_COLOUR, lw=0, zorder=0)
    axes.axvline(values.index(sweep.harmless), color="#bbbbbb", lw=1, ls=":", zorder=1)
    present = {row.method for row in rows}
    for name in (each for each in STYLES if each in present):
        ratios = curve(rows, name)
        y = np.minimum([ratios[value] for value in values], TOP)
        size, order = 8 if name in LARGE else 3.5, 4 if name == "auto" else 3
        axes.plot(at, y, lw=1.3, ms=size, mew=0.9, zorder=order, **_look(name))
    axes.set_title(sweep.name.capitalize(), fontsize=11)
    axes.set_xlabel(sweep.unit, fontsize=9.5, labelpad=3)
    axes.set(ylim=(0, TOP * 1.05), xlim=(-0.3, len(values) - 0.7))
    axes.set_xticks(at, [f"{value:g}".replace("-", "−") for value in values], fontsize=8.5)


def calibration(path: Path, results: Results) -> None:
    """Draw the deviation that auto states against its true error, a mark an image, filled if it has a warning."""
    with figure(path, 10, 5.6) as chart:
        right, wrong = chart.subplots(1, 2, sharey=True, sharex=True)
        _deviations(right, "Restoration has the right settings", [one for one in results if one[0].configured])
        _deviations(wrong, "It does not know of the fault", [one for one in results if not one[0].configured])
        right.set_ylabel("true error (kPa, root mean square)")
        right.text(0.13, 60, f"more than {1 / HONEST:g} times as wrong as stated", fontsize=9, color="#7d3600")


def _deviations(axes: Axes, title: str, results: Results) -> None:
    for number, (sweep, all_rows) in enumerate(results):
        rows = [row for row in all_rows if row.method == "auto" and row.stated > 0]
        colour, mark = COLOURS[number % len(COLOURS)], "os^DvPX*<>h"[number % 11]
        style: dict[str, Any] = {"color": colour, "marker": mark, "ls": "", "ms": 5, "mew": 0.9}
        for warned in (True, False):
            some = [row for row in rows if (row.flagged or bool(row.warnings)) is warned]
            stated, error = [row.stated for row in some], [row.error for row in some]
            axes.plot(stated, error, mfc=colour if warned else "none", alpha=0.45 if warned else 1, **style)
        axes.plot([], [], mfc="none", label=sweep.name, **style)
    low, high = 0.02, 200.0
    axes.fill_between([low, high], [low / HONEST, high / HONEST], [1e3, 1e3], color=WORSE_COLOUR, lw=0, zorder=0)
    axes.plot([low, high], [low, high], color="#444444", lw=1)
    axes.set(xscale="log", yscale="log", xlim=(0.1, 100), ylim=(0.1, 100), title=title)
    axes.set_xlabel("stated standard deviation (kPa, of 100)")
    axes.plot([], [], "o", color="#444444", alpha=0.45, label="filled: warned")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8.5, ncols=3, handletextpad=0.1)
