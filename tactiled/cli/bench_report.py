"""`tactiled bench report`: everything measured, on one page."""

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from tactiled.cli.bench_frontier import made


def report(
    config: Annotated[Path | None, typer.Option(help="Configuration whose array and cover to measure.")] = None,
    sensor: Annotated[str | None, typer.Option(help="Its sensor; the first if left out.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for index.html, its charts and tables.")] = Path("bench"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Under a minute: fewer covers, faults, scenes, frames.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 1,
) -> None:
    """Measure speed, accuracy, limits and failures, and write one page that holds all charts and tables."""
    from tactiled.study import report as make  # matplotlib and scikit-image take a second
    from tactiled.study.report_page import write
    from tactiled.study.skin import configured

    folder = made(out)
    columns = (TextColumn("{task.description:<44}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with threadpool_limits(1), Progress(*columns, transient=True) as progress:
        todo = make.plan((configured(config, sensor),) if config else (), quick, seed)
        task = progress.add_task("starting", total=todo.steps)
        found = make.measure(todo, lambda done: progress.update(task, advance=1, description=done))
    print(write(folder, found, seed))
