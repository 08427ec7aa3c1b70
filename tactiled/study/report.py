"""Speed, accuracy, limits and failures of restoration on one page."""

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from string import Template

import numpy as np

from tactiled.study import frontier, picard, stability
from tactiled.study.page import page, svg, table, text, tiles
from tactiled.study.results import machine
from tactiled.study.skin import Skin


def write(folder: Path, skins: Sequence[Skin], reduced: bool, seed: int) -> Path:
    """Measure, draw every chart, write every table, and the page that holds them all; give its path."""
    panels = frontier.measure(skins, reduced, seed)
    results = stability.measure(stability.setting(reduced, seed, *skins))
    modes = picard.measure(skins, 0.01, seed)
    frontier.write(folder, panels, seed)
    stability.write(folder, results, seed)
    picard.write(folder, modes)
    body = Template(Path(__file__).with_suffix(".html").read_text(encoding="utf-8")).substitute(
        machine=escape(machine()),
        seed=seed,
        headlines=tiles(_headlines(panels, results)),
        frontier_table=table(frontier.HEADINGS, frontier.lines(panels), good=("nothing",)),
        frontier_verdict=text(*frontier.verdict(panels)),
        stability_table=table(stability.HEADINGS, stability.lines(results), good=("none", "nothing to notice")),
        stability_verdict=text(*stability.verdict(results)),
        **{name: svg(folder / f"{name}.svg") for name in ("frontier", "picard", "stability", "calibration")},
    )
    path = folder / "index.html"
    path.write_text(page("Speed against accuracy, and where methods fail", [body]), encoding="utf-8")
    return path


def _headlines(panels: list[frontier.Panel], results: stability.Results) -> Iterator[tuple[str, str]]:
    ratio = np.mean([one.mark("auto").nrmse / one.mark("raw").nrmse for one in panels])
    times = [one.mark("auto").median for one in panels]
    words = "less" if ratio < 1 else "more"
    yield f"{100 * abs(1 - ratio):.0f} % {words} error", "auto against the raw image, mean of the panels below"
    yield f"{min(times):.0f} to {max(times):.0f} µs a frame", "median of auto, by panel"
    if peers := [(one.mark("auto"), peer) for one in panels if (peer := one.best_peer)]:
        faster = np.median([peer.median / auto.median for auto, peer in peers])
        closer = sum(auto.nrmse < peer.nrmse for auto, peer in peers)
        words = f"as the best setting of other libraries, and more accurate in {closer} of {len(peers)} panels"
        yield f"{faster:.0f} x as fast", words
    broken = [
        sweep.name for sweep, rows in results if stability.breaks(stability.curve(rows, "auto"), sweep.harmless)
    ]
    words = f"make auto worse than the raw image: {', '.join(broken) or 'none'}"
    yield f"{len(broken)} of {len(results)} faults", words
