"""`tactiled restore`: frames of any number, from file to file."""

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from os.path import realpath
from pathlib import Path
from threading import Event
from typing import Annotated, BinaryIO

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from tactiled.build import sensor_plan
from tactiled.cli import options
from tactiled.cli.app import EXIT_INTERRUPTED, interrupted
from tactiled.errors import ConfigError
from tactiled.restore.methods import METHODS
from tactiled.runtime.offline import FrameInfo, Offline, create, open_frames, write

PROGRESS_FROM_FRAMES = 2000  # fewer take about a second
PROGRESS = "{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()


def restore(
    frames: Annotated[Path, typer.Argument(help="Frames (T, rows, columns) or (T, taxels), NaN: unknown.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Where the restored frames go (.npy, float32).")],
    config: Annotated[Path, typer.Option(help="Configuration that describes the sensor (TOML).")],
    sensor: options.Sensor = None,
    method: Annotated[str, typer.Option(help="One of " + ", ".join(METHODS) + ".")] = "auto",
    noise: Annotated[float | None, typer.Option(help="A taxel's standard deviation, in the frames' unit.")] = None,
    stats: Annotated[Path | None, typer.Option(help="File for method and time of each frame (JSON).")] = None,
) -> None:
    """Restore the frames of a .npy file, however many, with bounded memory."""
    _refuse_same(out, "--out", {"--config": config})
    if stats is not None:
        _refuse_same(stats, "--stats", {"--config": config, "FRAMES": frames, "--out": out})
    _, name, one = options.one_sensor(config, sensor)
    plan = sensor_plan(name, one)
    kpa = open_frames(frames, plan)
    console = Console(stderr=True)
    with threadpool_limits(1), interrupted() as stop, ExitStack() as stack:
        offline = Offline(plan, kpa, method, noise)
        file, methods = stack.enter_context(create(stats)) if stats else None, Counter[str]()
        hidden = len(kpa) < PROGRESS_FROM_FRAMES
        progress = stack.enter_context(Progress(*PROGRESS, console=console, disable=hidden))
        task = progress.add_task("restoring", total=len(kpa))
        shape = (len(kpa), *plan.blur.surface_shape)
        images = _counted(iter(offline), stop, methods, file)
        write(images, shape, out, lambda count: progress.advance(task, count))
    summary = ", ".join(f"{name} {count}" for name, count in methods.most_common()) or "no frames"
    typer.echo(
        f"{out}: {' x '.join(map(str, shape))}, noise {offline.noise_kpa:.3g} {plan.unit}: {summary}", err=True
    )


def _refuse_same(path: Path, option: str, others: dict[str, Path]) -> None:
    """ConfigError where `path` is one of the other files."""
    for name, other in others.items():
        if realpath(path) == realpath(other):
            raise ConfigError(f"{option} {path}: is {name}, too: give another file")


def _counted(
    pieces: Iterator[tuple[NDArray[np.float32], list[FrameInfo]]],
    stop: Event,
    methods: Counter[str],
    file: BinaryIO | None,
) -> Iterator[NDArray[np.float32]]:
    """Pass the images on until `stop`; count the methods used, and write a JSON list with one line a frame."""
    for images, infos in pieces:
        if stop.is_set():
            raise typer.Exit(EXIT_INTERRUPTED)
        for each in infos:
            if file is not None:
                start = ",\n" if methods else "[\n"
                file.write((start + json.dumps(each._asdict())).encode())
            methods[each.method] += 1
        yield images
    if file is not None:
        file.write(b"\n]\n" if methods else b"[]\n")
