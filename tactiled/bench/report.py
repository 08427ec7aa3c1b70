"""Speed, accuracy, limits and failures of restoration on one page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template

from tactiled.bench import frontier, picard, stability
from tactiled.bench.page import page, svg, table, text
from tactiled.bench.results import machine
from tactiled.bench.skin import Skin


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
        frontier_table=table(frontier.HEADINGS, frontier.lines(panels), good=("nothing",)),
        frontier_verdict=text(*frontier.verdict(panels)),
        stability_table=table(stability.HEADINGS, stability.lines(results), good=("none", "nothing to notice")),
        stability_verdict=text(*stability.verdict(results)),
        **{name: svg(folder / f"{name}.svg") for name in ("frontier", "picard", "stability", "calibration")},
    )
    path = folder / "index.html"
    path.write_text(page("Speed against accuracy, and where methods fail", [body]), encoding="utf-8")
    return path
