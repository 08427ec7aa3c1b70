"""`tactiled bench stability`: where methods fail, and whether anyone would notice."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.cli.bench_frontier import made
from tactiled.study.machine import describe

if TYPE_CHECKING:
    from tactiled.study.pairs import Pair
    from tactiled.study.stability import Found

SHOWN = 5  # pairs


def stability(
    config: Annotated[Path | None, typer.Option(help="Configuration whose array and cover to measure.")] = None,
    sensor: Annotated[str | None, typer.Option(help="Its sensor; the first if left out.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the charts and tables.")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer values and scenes; rubber on 16 x 16.")] = False,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 1,
) -> None:
    """Let one thing after another go wrong, and show where each method becomes worse than the raw image."""
    from tactiled.study import pairs
    from tactiled.study import stability as measure  # matplotlib and scikit-image take a second
    from tactiled.study.skin import configured
    from tactiled.study.stability_chart import calibration, draw
    from tactiled.study.stability_files import write
    from tactiled.study.sweeps import sweeps

    folder = made(out)
    with threadpool_limits(1):
        setting, values = measure.setting(quick, seed, configured(config, sensor) if config else None)
        steps = measure.measure(setting, values)
        found = list(track(steps, "Stability", len(sweeps(setting)), transient=True))
        together = list(track(pairs.measure(setting, quick), "Two at once", pairs.count(quick), transient=True))
    write(folder, found, together, seed)
    draw(folder / "stability.svg", found)
    draw(folder / "stability-wiener.svg", found, "wiener")
    calibration(folder / "calibration.svg", found)
    console = Console(soft_wrap=True, highlight=False)
    console.print(_table(found))
    for line in (*_unnoticed(found), *_pairs(together), *_silent(found, together)):
        console.print(line)
    said, fine = measure.false_warnings(found, "auto"), measure.sound(found, "auto")
    console.print(f"Warnings on {len(fine)} sound images of auto: {len(said)}.")
    console.print(f"Seed {seed}. One thread. {describe()}")
    console.print(f"Written: {folder}/stability.svg, stability-wiener.svg, calibration.svg, stability.csv,")
    console.print("stability-pairs.csv, stability-table.csv, stability.json")


def _table(found: "Found") -> Table:
    """Which methods break at each fault, and where; a column for each would be too narrow to read."""
    from tactiled.study.stability import table as judged
    from tactiled.study.stability_table import HEADINGS, lines

    table = Table(title="Methods whose mean error is over 1.02 times the raw image's", title_justify="left")
    for name in ("goes wrong", "worse than raw from", "noticed on auto"):
        table.add_column(name)
    for row in lines(judged(found)):
        cells = dict(zip(HEADINGS, row, strict=True))
        broken = [f"{name} {cells[name]}" for name in HEADINGS[1:-3] if cells[name] not in ("never", "")]
        table.add_row(cells["goes wrong"], "; ".join(broken) or "none", cells["noticed on auto"])
    return table


def _unnoticed(found: "Found") -> Iterator[str]:
    """Faults of which not all is noticed by a warning, and what shows them."""
    from tactiled.study.stability import table
    from tactiled.study.stability_table import lines

    for *row, worst, noticed, by in lines(table(found)):
        if by or noticed.startswith("no ("):
            yield f"auto, {row[0]}: at its worst {worst}; noticed: {noticed}; {by or 'nothing would show it'}"


def _pairs(together: "Sequence[Pair]") -> Iterator[str]:
    from tactiled.study import pairs

    for pair in pairs.worst(together, SHOWN):
        ratios = ", ".join(f"{method} {over:.2f}" for method, over in pair.over_raw.items() if method != "raw")
        yield f"{pairs.name(pair.faults)}, error over the raw image's: {ratios}"
    yield pairs.verdict(together)


def _silent(found: "Found", together: "Sequence[Pair]") -> Iterator[str]:
    from tactiled.study import silence

    listed = silence.listed(found, together)
    yield silence.verdict(listed)
    for line in silence.lines(listed):
        yield "; ".join(f"{name}: {cell}" for name, cell in zip(silence.HEADINGS, line, strict=True) if cell)
