"""Error against time, a panel for every cover and noise."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tactiled.study.charts import COLOURS, figure
from tactiled.study.frontier import FLOOR, Mark, Panel
from tactiled.study.peers import ours

BLUE, RED, GREEN, PINK, BLACK, SKY = COLOURS
GREY = "#777777"
SIZES = {"auto": 10, "nnls": 14}  # points: auto often picks nnls, and then both must show
DASHES = (0, (5, 3))
END = 1e7  # µs, past the right edge
STYLES = {  # name as it begins -> label, mark, colour; the longest that fits counts
    "auto": ("auto", "*", BLACK),
    "raw": ("raw image", "X", GREY),
    "wiener": ("wiener", "o", BLUE),
    "nnls": ("nnls", "^", GREEN),
    "tv": ("tv", "d", GREEN),
    "points": ("points", "v", PINK),
    "rl": ("rl: 5, 30 (default), 200 iterations", "s", RED),
    "rl-fast": ("rl-fast", "P", SKY),
    "skimage wiener": ("scikit-image wiener, 3 weights", "o", BLUE),
    "skimage unsupervised": ("scikit-image unsupervised_wiener", "D", PINK),
    "skimage rl": ("scikit-image richardson_lucy: 10, 30, 100", "s", RED),
    "opencv wiener": ("OpenCV, Wiener on its dft, 3 weights", "h", SKY),
    "pyproximal nnls": ("pyproximal, NNLS by FISTA: 10, 30", "^", BLACK),
}


def draw(path: Path, found: list[Panel]) -> None:
    """Draw the panels into `path`: covers down, noises across."""
    skins = list(dict.fromkeys(one.skin for one in found))
    noises = list(dict.fromkeys(one.noise for one in found))
    with figure(path, 10, 1.3 + 2.6 * len(skins)) as drawn:
        grid = drawn.subplots(len(skins), len(noises), sharex=True, sharey="row", squeeze=False)
        for one in found:
            row = [each for each in found if each.skin == one.skin]
            _panel(grid[skins.index(one.skin), noises.index(one.noise)], one, _top(row))
        for axes, skin in zip(grid[:, 0], skins, strict=True):
            axes.set(ylim=(0, 1.04 * _top([one for one in found if one.skin == skin])))
        times = [mark.median for one in found for mark in one.marks]
        grid[0, 0].set(xscale="log", xlim=(min(times) / 2, max(times) * 2))
        for axes in grid[-1]:
            axes.set_xlabel("median time a frame (µs)")
        for axes, skin in zip(grid[:, 0], skins, strict=True):
            axes.set_ylabel(f"{skin}\nerror (NRMSE)")
        for axes, noise in zip(grid[0], noises, strict=True):
            axes.set_title(f"Noise {100 * noise:g} % of the peak")
        _legend(drawn, found[0])


def _top(row: list[Panel]) -> float:
    """The largest error of a row that is drawn to scale: the raw image's and a quarter more."""
    return 1.25 * max(one.mark("raw").nrmse for one in row)


def style(name: str) -> tuple[str, str, str]:
    """Label, mark and colour of a method."""
    return STYLES[max((key for key in STYLES if name.startswith(key)), key=len)]


def _panel(axes: Axes, panel: Panel, top: float) -> None:
    """Draw one cover and noise; errors above `top` are marked at the edge."""
    chosen = sorted((mark for mark in panel.marks if mark.front), key=lambda mark: mark.median)
    x, y = [mark.median for mark in chosen], [mark.nrmse for mark in chosen]
    axes.step([*x, END], [*y, y[-1]], where="post", color="#999999", lw=1.3, zorder=1)
    axes.axhline(panel.floor, color=PINK, lw=1.3, ls=DASHES, zorder=1)
    for name in ("skimage rl", "rl"):
        same = sorted((m for m in panel.marks if style(m.method) is STYLES[name]), key=lambda m: m.median)
        axes.plot([m.median for m in same], [min(m.nrmse, top) for m in same], color=RED, lw=0.8, ls=":", zorder=2)
    for mark in panel.marks:
        _mark(axes, mark, top)
    mine = panel.mark("auto")
    look: Any = {"ha": "right", "fontsize": 9.5, "fontweight": "bold"}
    down, align = (-6, "top") if mine.nrmse > 0.15 * top else (0, "center")  # beside where the axis is near
    axes.annotate("auto", (mine.median, mine.nrmse), (-7, down), textcoords="offset points", va=align, **look)


def _mark(axes: Axes, mark: Mark, top: float) -> None:
    """Draw one method; at the upper edge with an arrow where it is off the scale."""
    _, shape, colour = style(mark.method)
    y, size = min(mark.nrmse, top), SIZES.get(mark.method, 6.5)
    fill = colour if mark.ours and mark.method != "nnls" else "white"
    axes.plot(
        mark.median, y, shape, color=colour, mfc=fill, ms=size, mew=1.2, zorder=4 if mark.method == "auto" else 3
    )
    if mark.nrmse > top:
        axes.annotate("↑", (mark.median, y), (7, 0), textcoords="offset points", va="center", color=colour)


def _legend(drawn: Figure, panel: Panel) -> None:
    present = [STYLES[key] for key in STYLES if any(style(m.method) is STYLES[key] for m in panel.marks)]
    hollow = {STYLES[key][0] for key in STYLES if not ours(key) or key == "nnls"}
    handles = [
        Line2D(
            [],
            [],
            ls="",
            marker=shape,
            color=colour,
            mfc="white" if label in hollow else colour,
            ms=SIZES.get(label, 6.5),
            label=label,
        )
        for label, shape, colour in present
    ]
    handles.append(Line2D([], [], color="#999999", lw=1.3, label="Pareto front: nothing else beats it in both"))
    handles.append(Line2D([], [], color=PINK, lw=1.3, ls=DASHES, label=FLOOR))
    drawn.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9.5, columnspacing=1.5)
