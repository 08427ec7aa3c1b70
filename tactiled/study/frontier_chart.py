"""Error against time, a panel for every cover and noise."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tactiled.study.charts import COLOURS, OURS, figure
from tactiled.study.frontier import BOUND, Mark, Panel
from tactiled.study.peers import ours

BLUE, RED, _, PINK, BLACK, SKY = COLOURS
SIZES = {"auto": 10, "nnls": 14}  # points: auto often selects nnls, and then both must show
DASHES = (0, (5, 3))
RIGHT_END = 1e7  # µs, past the right edge
STYLES = {  # start of the name -> label, mark, colour; the longest that fits counts
    "auto": ("auto", *OURS["auto"]),
    "raw": ("raw image", "X", "#777777"),
    **{name: (name, *look) for name, look in OURS.items()},
    "skimage wiener": ("scikit-image wiener, 3 weights", "o", BLUE),
    "skimage unsupervised": ("scikit-image unsupervised_wiener", "D", PINK),
    "skimage rl": ("scikit-image richardson_lucy: 10, 30, 100", "s", RED),
    "opencv wiener": ("OpenCV, Wiener on its dft, 3 weights", "h", SKY),
    "pyproximal nnls": ("pyproximal, NNLS by FISTA: 10, 30", "^", BLACK),
}


def draw(path: Path, panels: list[Panel]) -> None:
    """Draw the panels into `path`: covers down, noises across."""
    skins = list(dict.fromkeys(one.skin for one in panels))
    noises = list(dict.fromkeys(one.noise for one in panels))
    with figure(path, 10, 1.3 + 2.6 * len(skins)) as chart:
        grid = chart.subplots(len(skins), len(noises), sharex=True, sharey="row", squeeze=False)
        for row, skin in zip(grid, skins, strict=True):
            same = [one for one in panels if one.skin == skin]
            top = 1.25 * max(one.mark("raw").nrmse for one in same)  # larger errors are drawn at the edge
            for one in same:
                _panel(row[noises.index(one.noise)], one, top)
            row[0].set(ylim=(0, 1.04 * top), ylabel=f"{skin}\nerror (NRMSE)")
        times = [mark.median for one in panels for mark in one.marks]
        grid[0, 0].set(xscale="log", xlim=(min(times) / 2, max(times) * 2))
        for top_axes, bottom_axes, noise in zip(grid[0], grid[-1], noises, strict=True):
            top_axes.set_title(f"Noise {100 * noise:g} % of the peak")
            bottom_axes.set_xlabel("median time a frame (µs)")
        _legend(chart, panels[0])


def _style(name: str) -> str:
    """The key of STYLES for a method."""
    return max((key for key in STYLES if name.startswith(key)), key=len)


def _panel(axes: Axes, panel: Panel, top: float) -> None:
    """Draw one cover and noise; errors above `top` are marked at the edge."""
    x, y = [mark.median for mark in panel.front], [mark.nrmse for mark in panel.front]
    axes.step([*x, RIGHT_END], [*y, y[-1]], where="post", color="#999999", lw=1.3, zorder=1)
    axes.axhline(panel.floor, color=PINK, lw=1.3, ls=DASHES, zorder=1)
    stops = sorted((m for m in panel.marks if m.method.startswith("skimage rl")), key=lambda m: m.median)
    axes.plot([m.median for m in stops], [min(m.nrmse, top) for m in stops], color=RED, lw=0.8, ls=":", zorder=2)
    for mark in panel.marks:
        _mark(axes, mark, top)
    auto = panel.mark("auto")
    look: Any = {"ha": "right", "fontsize": 9.5, "fontweight": "bold"}
    down, align = (-6, "top") if auto.nrmse > 0.15 * top else (0, "center")  # beside where the axis is near
    axes.annotate("auto", (auto.median, auto.nrmse), (-7, down), textcoords="offset points", va=align, **look)


def _look(name: str) -> dict[str, Any]:
    """Mark of a method: hollow if another library's, or nnls, which is below auto's star."""
    _, shape, colour = STYLES[_style(name)]
    fill = colour if ours(name) and name != "nnls" else "white"
    return {"ls": "", "marker": shape, "color": colour, "mfc": fill, "ms": SIZES.get(name, 6.5)}


def _mark(axes: Axes, mark: Mark, top: float) -> None:
    """Draw one method; at the upper edge with an arrow where it is off the scale."""
    y, look = min(mark.nrmse, top), _look(mark.method)
    axes.plot(mark.median, y, mew=1.2, zorder=4 if mark.method == "auto" else 3, **look)
    if mark.nrmse > top:
        arrow: Any = {"textcoords": "offset points", "va": "center", "color": look["color"]}
        axes.annotate("↑", (mark.median, y), (7, 0), **arrow)


def _legend(chart: Figure, panel: Panel) -> None:
    present = {_style(mark.method) for mark in panel.marks}
    handles = [Line2D([], [], label=STYLES[key][0], **_look(key)) for key in STYLES if key in present]
    handles.append(Line2D([], [], color="#999999", lw=1.3, label="Pareto front: nothing else beats it in both"))
    handles.append(Line2D([], [], color=PINK, lw=1.3, ls=DASHES, label=BOUND))
    chart.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9.5, columnspacing=1.5)
