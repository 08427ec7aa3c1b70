"""Speed, accuracy, limits and failures of restoration on one page."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

import numpy as np

from tactiled.study import frontier, picard, stability
from tactiled.study.faults import Setting, sweeps
from tactiled.study.page import page, svg, table, text, tiles
from tactiled.study.results import machine
from tactiled.study.skin import Skin, rubber

PICARD_NOISE = 0.01  # of the peak
TITLE = "Speed against accuracy, and where methods fail"
LINKS = {"speed": "Speed", "limits": "Limits", "failures": "Failures", "deviation": "Stated deviation"}


@dataclass(frozen=True, slots=True)
class Plan:
    """How much to measure, on which skins."""

    skins: tuple[Skin, ...]
    effort: frontier.Effort
    setting: Setting
    values: slice
    seed: int

    @property
    def steps(self) -> int:
        """How often `measure` calls `step`."""
        return len(self.skins) * len(self.effort.noises) + len(sweeps(self.setting)) + 1


@dataclass(frozen=True, slots=True)
class Results:
    """All results."""

    panels: list[frontier.Panel]
    sweeps: stability.Results
    modes: list[picard.Picard]


def plan(skins: tuple[Skin, ...], quick: bool, seed: int) -> Plan:
    """The default report, or the quick one; rubber covers where no skins are given."""
    effort = frontier.QUICK_EFFORT if quick else replace(frontier.Effort(), rounds=3)
    setting, values = stability.setting(quick, seed, skins[0] if skins else None)
    return Plan(skins or tuple(rubber(t, effort.size) for t in effort.covers), effort, setting, values, seed)


def measure(plan: Plan, step: Callable[[str], None]) -> Results:
    """Measure it all; `step` gets the name of each part when it is done."""
    panels, swept = [], []
    for panel in frontier.measure(plan.skins, plan.effort, plan.seed):
        panels.append(panel)
        step(f"speed against accuracy: {panel.skin}, {100 * panel.noise:g} %")
    for sweep in stability.measure(plan.setting, plan.values):
        swept.append(sweep)
        step(f"stability: {sweep[0].name}")
    modes = [picard.measure(skin, PICARD_NOISE, plan.seed) for skin in plan.skins]
    step("limits")
    return Results(panels, swept, modes)


def write(folder: Path, results: Results, seed: int) -> Path:
    """Draw every chart, write every table, and the page that holds them all; give its path."""
    frontier.write(folder, results.panels, seed)
    stability.write(folder, results.sweeps, seed)
    picard.write(folder, results.modes)
    path = folder / "index.html"
    path.write_text(page(TITLE, _parts(folder, results, seed)), encoding="utf-8")
    return path


def _parts(folder: Path, results: Results, seed: int) -> Iterator[str]:
    yield f"<h1>{TITLE}</h1>"
    yield f"<p class='soft'>{escape(machine())}. One thread. Seed {seed}.</p>"
    yield tiles(_headlines(results))
    yield text(
        "Scenes are drawn four times finer than the taxels, off their grid, and blurred by the exact solution"
        " of the cover; restoration uses finite elements and never gets the kernel that blurred. Errors are"
        " ||image − truth|| / ||truth||. None of our settings is tuned with the truth.",
        "Run it on your own skin: `tactiled bench report --config CONFIG --out DIR`.",
    )
    yield "<nav>" + "".join(f"<a href='#{name}'>{title}</a>" for name, title in LINKS.items()) + "</nav>"
    yield from _speed(folder, results)
    yield from _limits(folder)
    yield from _failures(folder, results)
    yield from _deviation(folder)


def _headlines(results: Results) -> Iterator[tuple[str, str]]:
    panels = results.panels
    ratio = np.mean([one.mark("auto").nrmse / one.mark("raw").nrmse for one in panels])
    times = [one.mark("auto").median for one in panels]
    words = "less" if ratio < 1 else "more"
    yield f"{100 * abs(1 - ratio):.0f} % {words} error", "auto against the raw image, mean of the panels below"
    yield f"{min(times):.0f} to {max(times):.0f} µs a frame", "median of auto, by panel"
    peers = [(one.mark("auto"), peer) for one in panels if (peer := one.best_peer)]
    if peers:
        faster = np.median([peer.median / auto.median for auto, peer in peers])
        closer = sum(auto.nrmse < peer.nrmse for auto, peer in peers)
        words = f"as the best setting of other libraries, and more accurate in {closer} of {len(peers)} panels"
        yield f"{faster:.0f} x as fast", words
    broken = [
        sweep.name
        for sweep, rows in results.sweeps
        if stability.breaks(stability.curve(rows, "auto"), sweep.harmless)
    ]
    names = ", ".join(broken) or "none"
    yield f"{len(broken)} of {len(results.sweeps)} faults", f"make auto worse than the raw image: {names}"


def _speed(folder: Path, results: Results) -> Iterator[str]:
    yield "<h2 id='speed'>Speed against accuracy</h2>"
    yield text(
        "Every method restores the same clips, frame after frame, in one run. Down and to the left is better. The"
        " dashed line is the best that any filter of the cover's modes could reach with the truth's own"
        " spectrum: no linear method passes it. Non-negative methods can.",
    )
    caption = (
        "Error against time: filled marks are ours, hollow ones other libraries' at fixed settings (nnls, under"
        " auto's star, is hollow to be visible). An arrow marks what lies above the scale."
    )
    yield svg(folder / "frontier.svg", caption)
    yield table(frontier.HEADINGS, frontier.lines(results.panels), good="nothing")
    yield "<p class='soft'>NRMSE at the median time. The best of other libraries is selected with the truth.</p>"
    yield text(*frontier.verdict(results.panels))


def _limits(folder: Path) -> Iterator[str]:
    yield "<h2 id='limits'>Resolvable detail</h2>"
    yield text(
        "A cover weakens each pattern by its singular value; a pattern that sinks under the noise is lost to every"
        " linear method. Dividing by the singular value (red) then gives back noise, not the scene.",
    )
    caption = (
        "Left: singular values; a dot marks the last pattern of the scene above the noise. Right: the modes of one"
        " frame, in the blur's own order (grey: each, lines: their running root mean square)."
    )
    yield svg(folder / "picard.svg", caption)


def _failures(folder: Path, results: Results) -> Iterator[str]:
    yield "<h2 id='failures'>Where methods fail</h2>"
    yield text(
        "One thing at a time goes wrong, from harmless (dotted line) to hopeless. A method breaks where its mean"
        f" error over the scenes is more than {100 * (stability.WORSE - 1):.0f} % above the raw image's. It was"
        " noticed if the image has a flag or a warning, or if its stated deviation is at least half the error.",
    )
    yield svg(folder / "stability.svg", "Error over the raw image's; in the shaded part the raw image is better.")
    yield table(stability.HEADINGS, stability.lines(results.sweeps), good="none|nothing to notice")
    yield text(*stability.verdict(results.sweeps))


def _deviation(folder: Path) -> Iterator[str]:
    yield "<h2 id='deviation'>Stated and true deviation</h2>"
    yield text(
        "Every image has a standard deviation. On the line it is right; below the line it is cautious; in the"
        " shaded part the image is over twice as wrong as stated. Filled marks have a warning.",
    )
    yield svg(folder / "calibration.svg", "Stated deviation of auto against its true error, root mean squares.")
