"""Speed against accuracy: every method timed and scored on the same frames, in one run on one thread; a chart."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from rich.progress import track

from tactiled.bench.peers import STOPS, Restore, absent, peers
from tactiled.bench.results import write_csv, write_json
from tactiled.bench.skin import Clip, Skin, clips, into, nrmse, rubber
from tactiled.charts.style import BLACK, BLUE, OURS, PINK, RED, SKY, figure
from tactiled.restore.methods import METHODS, Restorer, make

BOUND = "best linear filter, given the truth's spectrum"
SIZES = {"auto": 10, "learned": 14}  # points: auto often selects learned, and then both must show
FLOOR_DASHES = (0, (5, 3))
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


@dataclass(frozen=True, slots=True)
class Effort:
    """How much to measure."""

    covers: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0)  # t/pitch
    noises: tuple[float, ...] = (0.002, 0.01, 0.05)  # of the frame's peak
    size: int = 32
    frames: int = 8  # of every scene's clip
    rounds: int = 5  # the least median of them counts: others may be using the machine
    peer_rounds: int = 2  # of the other libraries, which are slow
    stops: tuple[int, ...] = STOPS


REDUCED = Effort(covers=(1.0, 3.0), noises=(0.01, 0.05), frames=2, rounds=3, peer_rounds=1, stops=STOPS[:2])


@dataclass(frozen=True, slots=True)
class Mark:
    """One method in one panel."""

    method: str
    ours: bool
    nrmse: float  # mean over the scenes' clips
    median: float  # microseconds a frame
    p99: float


@dataclass(frozen=True, slots=True)
class Panel:
    """One cover and one noise."""

    skin: str
    thickness: float  # pitches
    noise: float  # of the frame's peak
    floor: float  # NRMSE of the best linear filter that knows the truth's own spectrum
    marks: tuple[Mark, ...]

    def mark(self, method: str) -> Mark:
        """The mark of `method`."""
        return next(mark for mark in self.marks if mark.method == method)

    @property
    def front(self) -> list[Mark]:
        """The Pareto front, fastest first: nothing else is both faster and more accurate."""
        return sorted((one for one in self.marks if not better(self, one.method)), key=lambda one: one.median)

    @property
    def best_peer(self) -> Mark | None:
        """The most accurate mark that is none of ours."""
        return min((mark for mark in self.marks if not mark.ours), key=lambda mark: mark.nrmse, default=None)


def better(panel: Panel, method: str = "auto") -> list[Mark]:
    """The marks at least as fast and as accurate as `method`, and better in one of them."""
    own = panel.mark(method)
    no_worse = (mark for mark in panel.marks if mark.median <= own.median and mark.nrmse <= own.nrmse)
    return [mark for mark in no_worse if (mark.median, mark.nrmse) != (own.median, own.nrmse)]


def verdict(panels: Sequence[Panel]) -> Iterator[str]:
    """In how many panels `auto` is on the Pareto front, and which libraries are not compared."""
    count = sum(not better(panel) for panel in panels)
    yield f"auto is on the Pareto front in {count} of {len(panels)} panels."
    if names := absent():
        yield f"Not compared, as they are not installed (extra `peers`): {', '.join(names)}."


COLUMNS = ("auto", "raw", "wiener", "rl")
HEADINGS = ("cover", "noise", *COLUMNS, "best of other libraries", "floor", "beats auto in both")


def lines(panels: Sequence[Panel]) -> list[tuple[str, ...]]:
    """A table by HEADINGS: NRMSE at the median time."""

    def cell(mark: Mark) -> str:
        return f"{mark.nrmse:.3f} at {mark.median:.0f}\u00a0µs"

    table = []
    for panel in panels:
        cells = [cell(panel.mark(name)) for name in COLUMNS]
        peer = panel.best_peer
        cells += [f"{cell(peer)}, {peer.method}" if peer else "–", f"{panel.floor:.3f}"]
        cells.append(", ".join(mark.method for mark in better(panel)) or "nothing")
        table.append((panel.skin.replace(" ", "\u00a0"), f"{100 * panel.noise:g} %", *cells))
    return table


def measure(skins: Sequence[Skin], reduced: bool, seed: int) -> list[Panel]:
    """Measure every skin, or rubber if there is none, at every noise."""
    effort = REDUCED if reduced else Effort()
    skins = skins or [rubber(thickness, effort.size) for thickness in effort.covers]
    pairs = list(product(skins, effort.noises))
    return [panel(*pair, effort, seed) for pair in track(pairs, "Speed and accuracy", transient=True)]


def panel(skin: Skin, noise: float, effort: Effort, seed: int) -> Panel:
    """Measure one skin at one noise."""
    played: dict[str, list[list[tuple[float, list[float]]]]] = {}  # by method: the rounds of every clip
    floors = []
    for clip in clips(skin, noise, effort.frames, seed):
        floors.append(floor(skin, clip))
        for name, run in _runs(skin, clip, noise, effort.stops).items():
            rounds = effort.rounds if name in METHODS else effort.peer_rounds
            played.setdefault(name, []).append([_play(run, clip) for _ in range(rounds)])
    marks = []
    for name, of_clips in played.items():
        error = float(np.mean([rounds[0][0] for rounds in of_clips]))
        times = np.hstack([[took for _, took in rounds] for rounds in of_clips])  # rounds x frames
        median, p99 = np.percentile(times, (50, 99), axis=1).min(axis=1)
        marks.append(Mark(name, name in METHODS, error, float(median), float(p99)))
    return Panel(skin.name, skin.thickness, noise, float(np.mean(floors)), tuple(marks))


def floor(skin: Skin, clip: Clip) -> float:
    """Expected NRMSE of the best filter mode by mode, given how much of the truth is in each mode.

    No linear filter in the blur's modes passes it in the mean; a non-negative method may.
    """
    modes = skin.blur.modes
    truth = clip.truths[0]
    power = np.square(into(modes.surface, truth))
    gain = np.zeros_like(power)
    gain[modes.head] = modes.gain
    residual = power * clip.sigma**2 / np.maximum(gain**2 * power + clip.sigma**2, 1e-300)
    unseen = np.square(truth).sum() - power.sum()  # by the taxels of a layout
    return float(np.sqrt((residual.sum() + unseen) / np.square(truth).sum()))


def _play(run: Restore, clip: Clip) -> tuple[float, list[float]]:
    """Restore a clip: mean NRMSE, and microseconds of each frame."""
    errors, times = [], []
    for frame, truth in zip(clip.frames, clip.truths, strict=True):
        start = perf_counter()
        image = run(frame)
        times.append(1e6 * (perf_counter() - start))
        errors.append(nrmse(image, truth))
    return float(np.mean(errors)), times


def _runs(skin: Skin, clip: Clip, noise: float, stops: tuple[int, ...]) -> dict[str, Restore]:
    runs = {name: _own_run(make(name, skin.blur, clip.sigma), skin.felt) for name in METHODS}
    if skin.psf is not None:
        runs |= peers(skin.psf, clip.frames.shape[1:], noise, stops)
    return runs


def _own_run(restorer: Restorer, felt: NDArray[np.bool_]) -> Restore:
    return lambda frame: restorer(frame).image * felt


def write(folder: Path, panels: list[Panel], seed: int) -> None:
    """Draw the chart, write the marks to frontier.csv, and all measurements to frontier.json."""
    draw(folder / "frontier.svg", panels)
    columns = ("skin", "t/pitch", "noise", "method", "NRMSE", "median us", "p99 us", "on front")
    rows = (
        (one.skin, one.thickness, one.noise, mark.method, mark.nrmse, mark.median, mark.p99,
         int(mark in one.front))
        for one in panels
        for mark in one.marks
    )  # fmt: skip
    write_csv(folder / "frontier.csv", columns, rows)
    about = {"seed": seed, "threads": 1, "peers not installed": absent(), "floor": BOUND}
    marks = ([asdict(mark) | {"front": mark in one.front} for mark in one.marks] for one in panels)
    dicts = [asdict(one) | {"marks": each} for one, each in zip(panels, marks, strict=True)]
    write_json(folder / "frontier.json", about | {"panels": dicts})


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
                _draw_panel(row[noises.index(one.noise)], one, top)
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


def _draw_panel(axes: Axes, panel: Panel, top: float) -> None:
    """Draw one cover and noise; errors above `top` are marked at the edge."""
    x, y = [mark.median for mark in panel.front], [mark.nrmse for mark in panel.front]
    axes.step([*x, RIGHT_END], [*y, y[-1]], where="post", color="#999999", lw=1.3, zorder=1)
    axes.axhline(panel.floor, color=PINK, lw=1.3, ls=FLOOR_DASHES, zorder=1)
    stops = sorted((m for m in panel.marks if m.method.startswith("skimage rl")), key=lambda m: m.median)
    axes.plot([m.median for m in stops], [min(m.nrmse, top) for m in stops], color=RED, lw=0.8, ls=":", zorder=2)
    for mark in panel.marks:
        _mark(axes, mark, top)
    auto = panel.mark("auto")
    look: Any = {"textcoords": "offset points", "va": "bottom", "fontsize": 9.5, "fontweight": "bold"}
    axes.annotate("auto", (auto.median, auto.nrmse), (6, 2), **look)  # over the front's last line


def _look(name: str) -> dict[str, Any]:
    """Mark of a method: hollow if another library's, or nnls, which is below auto's star."""
    _, shape, colour = STYLES[_style(name)]
    fill = colour if name in METHODS and name != "learned" else "white"
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
    handles.append(Line2D([], [], color=PINK, lw=1.3, ls=FLOOR_DASHES, label=BOUND))
    chart.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9.5, columnspacing=1.5)
