"""`tactiled restore`: frames of any number, from file to file."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from os.path import realpath
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from threadpoolctl import threadpool_limits

from tactiled.archive.jobs import RestoreJob
from tactiled.archive.places import Place
from tactiled.cli import batch, options
from tactiled.cli.app import EXIT_INTERRUPTED, interrupted
from tactiled.errors import ConfigError
from tactiled.files import whole_file
from tactiled.restore.methods import METHODS
from tactiled.runtime.offline import FrameInfo

PROGRESS_FROM_FRAMES = 2000  # fewer take about a second


def restore(
    frames: Annotated[
        list[str],
        typer.Argument(help=f"Frames (T, rows, columns) or (T, taxels), NaN: unknown. Several: {batch.INPUTS}."),
    ],
    out: Annotated[
        str,
        typer.Option("--out", "-o", help=f"Where the restored frames go (.npy, float32); {batch.OUT}."),
    ],
    config: Annotated[Path, typer.Option(help="Configuration that describes the sensor (TOML).")],
    sensor: options.Sensor = None,
    method: Annotated[str, typer.Option(help="One of " + ", ".join(METHODS) + ".")] = "auto",
    noise: Annotated[float | None, typer.Option(help="A taxel's standard deviation, in the frames' unit.")] = None,
    stats: Annotated[
        Path | None, typer.Option(help="File for method and time of each frame (JSON), of one input.")
    ] = None,
    workers: batch.Workers = None,
    scheduler: batch.Scheduler = None,
) -> None:
    """Restore the frames of .npy files, however many, with bounded memory."""
    settings, name, _ = options.one_sensor(config, sensor)
    job = RestoreJob.of(config, settings, name, method=method, noise=noise)
    if one := batch.single(frames, out, workers, scheduler):
        _refuse_same(out, "--out", {"--config": config})
        if stats is not None:
            _refuse_same(stats, "--stats", {"--config": config, "FRAMES": frames[0], "--out": out})
        _restore_one(job, *one, stats)
        return
    if stats is not None:
        raise ConfigError(f"--stats {stats}: is one file for several inputs: leave it out")
    batch.run_batch(job, frames, (".npy",), out, workers, scheduler)


def _restore_one(job: RestoreJob, source: Place, target: Place, stats: Path | None) -> None:
    """Restore one file, with a bar if it is long; Ctrl-C ends it between two pieces."""
    with threadpool_limits(1), interrupted() as stop, ExitStack() as stack:
        offline = job.offline(stack.enter_context(source.local()))
        write_stats = stack.enter_context(_stats(stats))
        part = stack.enter_context(target.written(replace=True))
        console, hidden = Console(stderr=True), offline.shape[0] < PROGRESS_FROM_FRAMES
        progress = stack.enter_context(Progress(*batch.PROGRESS, console=console, disable=hidden))
        task = progress.add_task("restoring", total=offline.shape[0])

        def take(infos: list[FrameInfo]) -> None:
            if stop.is_set():
                raise typer.Exit(EXIT_INTERRUPTED)
            progress.advance(task, len(infos))
            write_stats(infos)

        methods = offline.write(part, take)
    typer.echo(f"{target}: {job.summary(offline, methods)}", err=True)


def _refuse_same(path: str | Path, option: str, others: dict[str, str | Path]) -> None:
    """ConfigError where `path` is one of the other files."""
    for name, other in others.items():
        if realpath(path) == realpath(other):
            raise ConfigError(f"{option} {path}: is {name}, too: give another file")


@contextmanager
def _stats(path: Path | None) -> Iterator[Callable[[list[FrameInfo]], None]]:
    """What writes frames' methods and times as a JSON list with a line each; nothing without a path."""
    if path is None:
        yield lambda _: None
        return
    with whole_file(path, replace=True) as part, part.open("w") as file:
        start = "[\n"

        def write(infos: list[FrameInfo]) -> None:
            nonlocal start
            for each in infos:
                file.write(start + json.dumps(each._asdict()))
                start = ",\n"

        yield write
        file.write("[]\n" if start == "[\n" else "\n]\n")
