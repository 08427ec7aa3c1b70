"""The report's page: what the charts show, in words, and the tables beside them."""

from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np

from tactiled.study import discriminate, frontier, frontier_chart, iterations, picard, stability, stability_files
from tactiled.study import stability_chart as charts
from tactiled.study.machine import describe
from tactiled.study.page import page, text, tiles
from tactiled.study.report import Findings
from tactiled.study.report_failures import doubt, failures
from tactiled.study.report_speed import limits, rules, speed

SMALL_COVERS = (1.0, 3.0)  # t/pitch of the small chart
SMALL_SWEEPS = ("cover", "white noise", "thickness wrong", "dead taxels", "over the edge", "taxels out of place")


def write(folder: Path, found: Findings, seed: int) -> Path:
    """Draw every chart, write every table, and the page that holds them all; give its path."""
    frontier.write(folder, found.panels, seed)
    stability_files.write(folder, found.sweeps, found.together, seed)
    frontier_chart.draw(folder / "frontier.svg", found.panels)
    charts.draw(folder / "stability.svg", found.sweeps)
    charts.draw(folder / "stability-wiener.svg", found.sweeps, "wiener")
    charts.calibration(folder / "calibration.svg", found.sweeps)
    iterations.draw(folder / "iterations.svg", found.counts)
    picard.draw(folder / "picard.svg", found.modes)
    if found.pairs:
        discriminate.draw(folder / "two-points.svg", found.pairs)
    few = [one for one in found.panels if one.thickness in SMALL_COVERS]
    frontier_chart.draw(folder / "frontier-small.svg", few or found.panels)
    charts.draw(folder / "stability-small.svg", found.sweeps, only=SMALL_SWEEPS)
    path = folder / "index.html"
    parts = (
        _top(found, seed),
        speed(folder, found),
        limits(folder, found),
        failures(folder, found),
        doubt(folder, found),
        rules(found),
    )
    said = [each for part in parts for each in part]
    path.write_text(page("Speed against accuracy, and where methods fail", said), encoding="utf-8")
    return path


def _top(found: Findings, seed: int) -> Iterator[str]:
    yield "<h1>Speed against accuracy, and where methods fail</h1>"
    yield f"<p class='soft'>{escape(describe())}. One thread. Seed {seed}.</p>"
    yield tiles(_headlines(found))
    yield text(
        "Scenes are drawn four times finer than the taxels, off their grid, and blurred by the exact solution"
        " of the cover; restoration uses finite elements, so it never sees the kernel that blurred. Errors are"
        " ||image − truth|| / ||truth||, and none of our settings is tuned with the truth at hand.",
        "Rerun it on your own skin: `tactiled bench report --config CONFIG --out DIR`.",
    )
    links = (
        ("speed", "Speed"),
        ("limits", "Limits"),
        ("failures", "Failures"),
        ("doubt", "Doubt"),
        ("rules", "Rules"),
    )
    yield "<nav>" + "".join(f"<a href='#{name}'>{title}</a>" for name, title in links) + "</nav>"


def _headlines(found: Findings) -> Iterator[tuple[str, str]]:
    over = np.mean([one.mark("auto").nrmse / one.mark("raw").nrmse for one in found.panels])
    times = [one.mark("auto").median for one in found.panels]
    yield (
        f"{100 * abs(1 - over):.0f} % {'less' if over < 1 else 'more'} error",
        "auto against the raw image, mean of the panels below",
    )
    yield (
        f"{min(times):.0f} to {max(times):.0f} µs a frame",
        "auto's median, from the easiest panel to the hardest",
    )
    peers = [frontier.best_peer(one) for one in found.panels]
    if all(peers):
        faster = [p.median / o.mark("auto").median for p, o in zip(peers, found.panels, strict=True) if p]
        better = sum(o.mark("auto").nrmse < p.nrmse for p, o in zip(peers, found.panels, strict=True) if p)
        yield (
            f"{np.median(faster):.0f} x as fast",
            (
                f"as the most accurate setting of others' methods in each panel, and more accurate in {better}"
                f" of {len(peers)}"
            ),
        )
    broken = [one for one in stability.table(found.sweeps) if one.method == "auto" and one.breaks_at]
    names = ", ".join(f"{one.sweep} ({one.breaks_at[0]:g} {one.unit})" for one in broken[:3]).replace("-", "−")
    if len(broken) > 3:
        names += f" and {len(broken) - 3} more"
    yield f"{len(broken)} of {len(found.sweeps)} faults", f"make auto worse than the raw image: {names or 'none'}"
