"""`tactiled restore`: frames of any number, from file to file."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from os.path import realpath
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress
from threadpoolctl import threadpool_limits

from tactiled.archive.jobs import RestoreJob
from tactiled.archive.places import Place
from tactiled.cli import batch, options
from tactiled.cli.app import EXIT_INTERRUPTED, interrupted
from tactiled.config import schema
from tactiled.config.load import validated
from tactiled.errors import ConfigError
from tactiled.files import whole_file
from tactiled.recorded.offline import FrameInfo
from tactiled.restore.methods import METHODS

LAYER = "T,E,NU: thickness in mm, Young's modulus in MPa, Poisson's ratio of a layer of the cover"
PROGRESS_FROM_FRAMES = 2000  # fewer take about a second


def restore(
    frames: Annotated[
        list[str],
        typer.Argument(
            help="Frames, .npy of (T, rows, columns) or (T, taxels), NaN: unknown, or .csv with a frame a line. "
            f"Several: {batch.INPUTS}."
        ),
    ],
    out: Annotated[
        str, typer.Option("--out", "-o", help=f"Where the restored frames go (.npy, float32); {batch.OUT}.")
    ],
    config: Annotated[
        Path | None,
        typer.Option(help="Configuration that describes the sensor (TOML); or the next three options."),
    ] = None,
    grid: Annotated[str | None, typer.Option(help="ROWSxCOLUMNS of a grid whose frames are in kPa.")] = None,
    pitch: Annotated[float | None, typer.Option(help="Distance between its taxels, mm.")] = None,
    layer: Annotated[list[str] | None, typer.Option(help=f"{LAYER}; repeat it from the top down.")] = None,
    sensor: options.Sensor = None,
    method: Annotated[str, typer.Option(help="One of " + ", ".join(METHODS) + ".")] = "auto",
    noise: Annotated[float | None, typer.Option(help="A taxel's standard deviation, in the frames' unit.")] = None,
    stats: Annotated[
        Path | None, typer.Option(help="File for method and time of each frame (JSON), of one input.")
    ] = None,
    workers: batch.Workers = None,
    scheduler: batch.Scheduler = None,
) -> None:
    """Restore the frames of .npy and .csv files, however many, with bounded memory."""
    given = options.present(grid=grid, pitch=pitch, layer=layer)
    if config is not None and given:
        raise ConfigError(f"--{min(given)}: --config says it: leave one of them out")
    settings, name, _ = options.one_sensor(config, sensor) if config else _described(given)
    job = RestoreJob.of(config or Path("options"), settings, name, method=method, noise=noise)
    if one := batch.single(frames, out, workers, scheduler):
        files: dict[str, str | Path] = {"--config": config} if config else {}
        _refuse_same(out, "--out", files)
        if stats is not None:
            _refuse_same(stats, "--stats", files | {"FRAMES": frames[0], "--out": out})
        _restore_one(job, *one, stats)
        return
    if stats is not None:
        raise ConfigError(f"--stats {stats}: is one file for several inputs: leave it out")
    batch.run_batch(job, frames, (".npy", ".csv"), out, workers, scheduler)


def _described(given: Mapping[str, Any]) -> tuple[schema.Config, str, schema.Sensor]:
    """The configuration that --grid, --pitch and --layer describe; ConfigError where one is missing or wrong."""
    if lacking := [each for each in ("grid", "pitch", "layer") if each not in given]:
        raise ConfigError(f"--{lacking[0]} is missing: give --config, or --grid, --pitch and --layer")
    rows, _, columns = given["grid"].partition("x")
    if not (rows.isdecimal() and columns.isdecimal()):
        raise ConfigError(f"--grid {given['grid']}: give ROWSxCOLUMNS, such as 8x6")
    keys = ("thickness_mm", "young_mpa", "poisson")
    cover = [dict(zip(keys, options.numbers("layer", each, LAYER, 3), strict=True)) for each in given["layer"]]
    array = {"rows": int(rows), "columns": int(columns), "pitch_mm": given["pitch"]}
    sensor = {"array": array, "cover": cover, "calibration": {"kpa_per_count": 1.0}}
    settings = validated(schema.Config, {"sensor": {"frames": sensor}}, "options")
    return settings, "frames", settings.sensor["frames"]


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
