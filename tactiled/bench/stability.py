"""Where methods fail: each fault swept from harmless to hopeless, and whether the image shows that it is wrong."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from rich.progress import track

from tactiled.bench.faults import Case, Setting, Sweep, cases, sweeps
from tactiled.bench.peers import skimage_rl, skimage_wiener
from tactiled.bench.results import write_csv, write_json
from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import Frames, Skin, nrmse, rms, rubber
from tactiled.charts.style import COLOURS, WORSE_COLOUR, figure
from tactiled.charts.style import OURS as LOOKS
from tactiled.diagnostics.checks import NOISE_RATIO, FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.restore.methods import METHODS, make
from tactiled.restore.noise import estimate

COVER = 1.5  # t/pitch, of the rubber
OURS = tuple(name for name in METHODS if name != "raw")
PEERS = ("skimage wiener", "skimage rl")
PEER_BALANCE, PEER_ITERATIONS = 0.3, 30  # scikit-image's: weight over the noise, iterations
WORSE = 1.02  # times the raw image's error: more is a failure
HONEST = 0.5  # of the true error: a stated deviation below it shows nothing
DASHES = {"tv": (0, (1, 1)), "skimage wiener": (0, (3, 2)), "skimage rl": (0, (3, 2))}
STYLES = {  # method -> label, mark, colour
    **{name: (name, *look) for name, look in LOOKS.items()},
    "skimage wiener": ("scikit-image wiener", "", COLOURS[0]),
    "skimage rl": ("scikit-image richardson_lucy", "", COLOURS[1]),
}
LARGE = ("auto", "learned")  # auto often selects learned, and then both must show
MAX_TICKS = 9  # whose texts have room at full length
TOP = 2.0  # times the raw image's error: more is drawn at the edge
COLUMNS = 3


@dataclass(frozen=True, slots=True)
class Row:
    """One method's image of one frame; errors and deviations are root mean squares in kPa."""

    sweep: str
    value: float
    scene: str
    method: str
    used: str  # the method that auto selected; empty for scikit-image's
    nrmse: float
    over_raw: float  # error over the raw image's
    error: float
    stated: float  # the image's stated standard deviation; NaN where there is none
    flagged: bool  # whether taxels have flags
    warnings: tuple[WarningCode, ...] = ()  # of the service at a first look

    @property
    def failed(self) -> bool:
        """Whether the image is worse than the raw one."""
        return self.over_raw > WORSE

    @property
    def noticed(self) -> bool:
        """Whether flags, a warning or the stated deviation show that the image may be wrong."""
        return self.flagged or bool(self.warnings) or self.stated >= HONEST * self.error


Results = Sequence[tuple[Sweep, list[Row]]]


def setting(reduced: bool, seed: int, skin: Skin | None = None) -> Setting:
    """What to run, on rubber if no skin is given."""
    if reduced:
        return Setting(skin or rubber(COVER, 16), seed, ("blobs", "punches", "points"), step=3)
    return Setting(skin or rubber(COVER, 32), seed, tuple(TEST_SCENES))


def measure(setting: Setting) -> Results:
    """Run every sweep."""
    return [(sweep, run(setting, sweep)) for sweep in track(sweeps(setting), "Faults", transient=True)]


def run(setting: Setting, sweep: Sweep) -> list[Row]:
    """Restore every scene at the sweep's harmless value and every step-th of the others."""
    values = [v for v in sweep.values if v in sweep.values[:: setting.step] or v == sweep.harmless]
    return [row for v in values for case in cases(setting, sweep, v) for row in restore(sweep.name, v, case)]


def restore(sweep: str, value: float, case: Case) -> list[Row]:
    """Restore one frame by every method."""
    images: dict[str, tuple[str, Frames, float]] = {}
    predicted: dict[str, Frames] = {}  # frames, of what lies beyond the array too
    for name in ("raw", *OURS):
        restorer = make(name, case.skin.blur, case.noise)
        for earlier in case.before:
            restorer(earlier, case.flags)
        done = restorer(case.frame, case.flags)
        felt = case.skin.felt
        images[name] = done.method, done.image * felt, rms(restorer.deviation()[felt])
        predicted[name] = restorer.predicted().copy()
    images |= {name: ("", image, np.nan) for name, image in _peers(case).items()}
    raw, flagged = nrmse(images["raw"][1], case.truth), bool(case.flags.any())
    rows = []
    for name, (used, image, stated) in images.items():
        error = nrmse(image, case.truth)
        errors = error, error / raw, rms(image - case.truth)
        warnings = _warnings(case, image, used, predicted.get(name))
        rows.append(Row(sweep, value, case.scene, name, used, *errors, stated, flagged, warnings))
    return rows


def _warnings(case: Case, image: Frames, used: str, predicted: Frames | None) -> tuple[WarningCode, ...]:
    checks = FrameChecks(case.skin.blur, case.floor)
    predict = None if predicted is None else lambda: np.asarray(predicted, np.float32)
    image = np.asarray(image, np.float32)
    warnings = checks.check(case.frame, case.flags, image, case.noise, used, predict)
    noisy = case.still is not None and estimate(case.still) > NOISE_RATIO * case.noise
    return (*warnings, "noise_high") if noisy else warnings


def _peers(case: Case) -> dict[str, Frames]:
    """scikit-image's two, at settings that need no truth; they know nothing of flags."""
    if case.skin.psf is None:
        return {}
    psf = case.skin.psf.astype(np.float32)
    balance = PEER_BALANCE * case.noise / max(float(case.frame.max()), case.noise)
    images = skimage_wiener(psf, balance, case.frame), skimage_rl(psf, PEER_ITERATIONS, case.frame)
    return dict(zip(PEERS, images, strict=True))


def curve(rows: list[Row], method: str) -> dict[float, float]:
    """Mean error of the scenes over the raw image's, by the value of the sweep."""

    def mean(value: float, name: str) -> float:
        return float(np.mean([row.nrmse for row in rows if (row.value, row.method) == (value, name)]))

    return {value: mean(value, method) / mean(value, "raw") for value in dict.fromkeys(row.value for row in rows)}


def breaks(ratios: dict[float, float], harmless: float) -> list[float]:
    """The first value worse than raw on either side of the harmless one, or the harmless one itself."""
    worse = sorted(value for value, ratio in ratios.items() if ratio > WORSE)
    if harmless in worse:
        return [harmless]
    below, above = ([v for v in worse if v < harmless], [v for v in worse if v > harmless])
    return below[-1:] + above[:1]


HEADINGS = ("goes wrong", "methods worse than raw, from", "auto at its worst", "noticed on auto")


def lines(results: Results) -> list[tuple[str, ...]]:
    """A table by HEADINGS: where each method is worse than raw, and how many failures of auto are noticed."""
    table = []
    for sweep, rows in results:
        places = []
        for method in dict.fromkeys(row.method for row in rows if row.method != "raw"):
            if values := breaks(curve(rows, method), sweep.harmless):
                places.append(f"{method} {', '.join(f'{value:g}' for value in values)}")
        at, worst = max(curve(rows, "auto").items(), key=lambda each: each[1])
        failed = [row.noticed for row in rows if row.method == "auto" and row.failed]
        noticed = f"{sum(failed)} of {len(failed)}" if failed else "nothing to notice"
        cells = ("; ".join(places) or "none", f"{worst:.2f} at {at:g}", noticed)
        table.append((f"{sweep.name} ({sweep.unit})", *(cell.replace(" -", " −") for cell in cells)))
    return table


def verdict(results: Results) -> tuple[str, str]:
    """How many failures of auto nothing shows, and how many warnings there are with the right settings."""
    every = [(sweep.name, row) for sweep, rows in results for row in rows if row.method == "auto"]
    silent = sum(row.failed and not row.noticed for _, row in every)
    sound = [row for name, row in every if name in ("cover", "white noise")]
    wrong = sum(bool(row.warnings) and not row.failed for row in sound)
    return (
        f"Images of auto that are worse than the raw image, and show it by nothing: {silent} of {len(every)}.",
        f"Warnings on {len(sound)} images with the right settings: {wrong}.",
    )


def write(folder: Path, results: Results, seed: int) -> None:
    """Draw both charts, write every image to stability.csv, and the table to stability.json."""
    draw(folder / "stability.svg", results)
    calibration(folder / "calibration.svg", results)
    columns = [*(field.name for field in fields(Row)), "noticed"]
    every = (row for _, rows in results for row in rows)
    write_csv(folder / "stability.csv", columns, ((*astuple(row), row.noticed) for row in every))
    table = [dict(zip(HEADINGS, line, strict=True)) for line in lines(results)]
    write_json(folder / "stability.json", {"seed": seed, "worse than raw by": WORSE, "table": table})


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
    fill = "white" if name == "learned" else colour
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
    dense = len(values) > MAX_TICKS  # without the zero before the point, neighbours do not touch
    texts = [f"{value:g}".replace("-", "−") for value in values]
    axes.set_xticks(at, [each.removeprefix("0") or "0" for each in texts] if dense else texts, fontsize=8.5)


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
