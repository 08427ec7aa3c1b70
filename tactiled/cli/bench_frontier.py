"""`tactiled bench frontier`: which method is worth its time, under which cover and noise."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.errors import ConfigError
from tactiled.study.machine import describe

if TYPE_CHECKING:
    from tactiled.study import frontier as measure


def frontier(
    config: Annotated[Path | None, typer.Option(help="Configuration whose array and cover to measure.")] = None,
    sensor: Annotated[str | None, typer.Option(help="Its sensor; the first if left out.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for frontier.svg, .csv and .json.")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer covers, noises and frames.")] = False,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 1,
) -> None:
    """Chart error against time for every method of ours and for others', in one run on one thread."""
    from tactiled.study import frontier as measure  # matplotlib and scikit-image take a second
    from tactiled.study.frontier_chart import draw
    from tactiled.study.peers import absent
    from tactiled.study.skin import configured, rubber

    effort = measure.QUICK if quick else measure.Effort()
    folder = made(out)
    with threadpool_limits(1):
        skins = [configured(config, sensor)] if config else [rubber(t, effort.size) for t in effort.covers]
        count = len(skins) * len(effort.noises)
        found = list(track(measure.panels(skins, effort, seed), "Frontier", count, transient=True))
    measure.write(folder, found, seed)
    draw(folder / "frontier.svg", found)
    console = Console(soft_wrap=True, highlight=False)
    console.print(_table(found))
    for line in measure.verdict(found):
        console.print(line)
    if names := absent():
        console.print(f"Left out, as they are not installed (extra peers): {', '.join(names)}.")
    console.print(f"Seed {seed}. One thread. {describe()}")
    console.print(f"Written: {folder}/frontier.svg, frontier.csv, frontier.json")


def made(folder: Path) -> Path:
    """Make a folder for results; ConfigError where it cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"folder {folder} cannot be made: {error.strerror}") from error
    return folder


def _table(found: "list[measure.Panel]") -> Table:
    """One row a panel: error and time of ours, the best of others' settings."""
    from tactiled.study.peers import ours

    table = Table(title="NRMSE, and median µs a frame", title_justify="left")
    names = ["auto", "raw", "wiener", "nnls", "tv", "rl", "rl-fast"]
    names += ["skimage wiener", "skimage rl", "opencv wiener", "pyproximal nnls"]
    for name in ("cover", "noise", *names, "floor"):
        table.add_column(name.replace(" ", "\n"), no_wrap=True)
    for one in found:
        cells = []
        for name in names:
            same = [mark for mark in one.marks if mark.method == name or mark.method.startswith(f"{name} ")]
            best = min(same if not ours(name) else same[:1], key=lambda mark: mark.nrmse, default=None)
            cells.append(f"{best.nrmse:.3f}\n{best.median:.0f}" if best else "–")
        table.add_row(one.skin, f"{100 * one.noise:g} %", *cells, f"{one.floor:.3f}")
    return table
