"""Many files at once: options, progress, and the end of a run, for the verbs that have them."""

from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import closing
from os.path import isdir
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from tactiled.archive.batch import Task, run
from tactiled.archive.jobs import Job
from tactiled.archive.places import NAME, Place, inputs, place
from tactiled.cli.app import EXIT_REFUSED
from tactiled.errors import ConfigError

PROGRESS = "{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
INPUTS = "files, folders, patterns with * in quotes, or URLs"
OUT = f"with {NAME}, where each input's name goes, several"
Workers = Annotated[int | None, typer.Option(help="Processes of this machine for several inputs.", min=1)]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask scheduler for several inputs.")]


def single(
    paths: Sequence[str], out: str, workers: int | None, scheduler: str | None
) -> tuple[Place, Place] | None:
    """One input and its output; None if `out` is a pattern for several."""
    if NAME in out:
        return None
    if len(paths) > 1:
        raise ConfigError(f"--out {out}: is one file for {len(paths)} inputs: put {NAME} where their names go")
    if isdir(paths[0]):  # noqa: PTH112  # which fails for a name that is too long
        raise ConfigError(f"--out {out}: is one file for a folder: put {NAME} where the names of its files go")
    if workers or scheduler:
        raise ConfigError(
            f"--out {out}: is one file, and workers are for several: put {NAME} where their names go"
        )
    return place(paths[0]), place(out)


def run_batch(
    job: Job, paths: Sequence[str], endings: Collection[str], out: str, workers: int | None, scheduler: str | None
) -> None:
    """Do a job for every input; a line or a bar on stderr tells how far it is. Ends with 2 if any failed."""
    if workers and scheduler:
        raise ConfigError(f"--workers {workers}: --scheduler has its own workers: give one of both")
    target, console, counts = place(out, plain=False), Console(stderr=True), Counter[str]()
    tasks = [
        Task(source, Place(target.path.replace(NAME, name), target.files))
        for name, source in inputs(paths, endings).items()
    ]
    with (
        Progress(*PROGRESS, console=console, disable=not console.is_terminal) as progress,
        closing(run(job, tasks, workers, scheduler)) as outcomes,
    ):
        bar = progress.add_task("files", total=len(tasks))
        for number, outcome in enumerate(outcomes, 1):
            counts[outcome.state] += 1
            progress.advance(bar)
            if outcome.state == "failed" or not console.is_terminal:
                state = "failed: " * (outcome.state == "failed")
                typer.echo(f"{number}/{len(tasks)} {state}{outcome.text}", err=True)
    typer.echo(f"{counts['written']} written, {counts['complete']} complete before, {counts['failed']} failed")
    if counts["failed"]:
        raise typer.Exit(EXIT_REFUSED)
