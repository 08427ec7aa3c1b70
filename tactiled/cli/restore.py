"""`tactiled restore`: a film of frames, from file to file."""

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Event
from typing import Annotated, BinaryIO

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from tactiled.build import SensorPlan, sensor_plan
from tactiled.cli.app import INTERRUPTED, interrupted
from tactiled.config import Config, load
from tactiled.errors import ConfigError, UnknownSensorError
from tactiled.restore.methods import METHODS
from tactiled.runtime.offline import Offline, Told, created, opened, write

LONG = 2000  # frames from which there is progress to show


def restore(
    frames: Annotated[Path, typer.Argument(help="Frames (T, rows, columns) or (T, taxels) in kPa, NaN: unknown.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Where the restored frames go (.npy, float32).")],
    config: Annotated[Path, typer.Option(help="Configuration that describes the sensor (TOML).")],
    sensor: Annotated[str | None, typer.Option(help="Which sensor of it, if there are several.")] = None,
    method: Annotated[str, typer.Option(help="One of " + ", ".join(METHODS) + ".")] = "auto",
    noise: Annotated[float | None, typer.Option(help="A taxel's standard deviation (kPa); else measured.")] = None,
    stats: Annotated[Path | None, typer.Option(help="Where to say what was done to each frame (JSON).")] = None,
) -> None:
    """Restore a film of any length in a .npy file, with bounded memory."""
    _apart(frames, out, config, stats)
    plan = _plan(load(config), config, sensor)
    film = opened(frames, plan)
    offline = Offline(plan, method, noise)
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    with threadpool_limits(1), interrupted() as stop, ExitStack() as stack:
        kpa = offline.begin(film)
        told = _Story(stack.enter_context(created(stats)) if stats else None)
        columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        progress = stack.enter_context(Progress(*columns, console=console, disable=len(film) < LONG))
        task = progress.add_task("restoring", total=len(film))
        images = told.through(offline(film), stop)
        shape = (len(film), *plan.blur.surface_shape)
        write(images, shape, out, lambda count: progress.advance(task, count))
        told.end()
    console.print(f"{out}: {' x '.join(map(str, shape))}, noise {kpa:.3g} kPa: {told.summary}", markup=False)


def _plan(settings: Config, path: Path, name: str | None) -> SensorPlan:
    names = list(settings.sensor)
    if name is None and len(names) != 1:
        raise ConfigError(f"{path}: {len(names)} sensors: give --sensor, one of {', '.join(names)}")
    if name is not None and name not in settings.sensor:
        raise UnknownSensorError(f"sensor {name!r}: not in {path}: give one of {', '.join(names)}")
    chosen = name or names[0]
    return sensor_plan(chosen, settings.sensor[chosen])


def _apart(frames: Path, out: Path, config: Path, stats: Path | None) -> None:
    """ConfigError where an answer would take another file's place; images may take that of their frames."""
    others = {"--config": config, "FRAMES": frames, "--out": out}
    pairs = [("--out", out, "--config")] + [("--stats", stats, other) for other in others]
    for name, path, other in pairs:
        try:
            same = path is not None and path.resolve() == others[other].resolve()
        except (OSError, RuntimeError) as error:  # the latter of links in a circle
            raise ConfigError(f"{name} {path}: {error}: give another file") from error
        if same:
            raise ConfigError(f"{name} {path}: is {other}, too: give another file")


class _Story:
    """Writes what was done to each frame as one JSON list, line by line, and counts it."""

    def __init__(self, file: BinaryIO | None) -> None:
        self._file, self._count = file, 0
        self._chosen: Counter[str] = Counter()

    def through(
        self, pieces: Iterator[tuple[NDArray[np.float32], list[Told]]], stop: Event
    ) -> Iterator[NDArray[np.float32]]:
        """Pass the images on; ends the command once it is to `stop`."""
        for images, told in pieces:
            if stop.is_set():
                raise typer.Exit(INTERRUPTED)
            for each in told:
                self._chosen[each.method] += 1
                if self._file is not None:
                    self._file.write(((",\n" if self._count else "[\n") + json.dumps(each._asdict())).encode())
                self._count += 1
            yield images

    def end(self) -> None:
        """Close the list."""
        if self._file is not None:
            self._file.write(b"\n]\n" if self._count else b"[]\n")

    @property
    def summary(self) -> str:
        """How often each method ran."""
        return ", ".join(f"{name} {count}" for name, count in self._chosen.most_common()) or "no frames"
