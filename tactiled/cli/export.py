"""`tactiled export`: a recording's images as arrays with their units and provenance."""

import hashlib
import time
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from tactiled import __version__
from tactiled.build import SensorPlan, make_codec, sensor_plan
from tactiled.bus.replay import Recording, frames
from tactiled.bus.router import Router
from tactiled.cli.app import choose
from tactiled.cli.replay import one_bus
from tactiled.cli.sinks import FORMATS, Sink
from tactiled.config import Config, load
from tactiled.errors import ConfigError, TactileError
from tactiled.files import whole
from tactiled.frames import BAD, DEAD, MISSING, SATURATED, Image, Loss, Message
from tactiled.runtime.pipeline import Pipeline

FLAGS = {"MISSING": MISSING, "BAD": BAD, "DEAD": DEAD, "SATURATED": SATURATED}
SHEAR = "counts from the skin's nominal rest, (x, y) along its own axes; as sensed, neither restored nor tared"
THERE = "is there already: name another file, or remove it first"
LOSS = tuple(each.name for each in fields(Loss))


def export(
    file: Annotated[Path, typer.Argument(help="Recording, in any format that python-can reads.")],
    config: Annotated[Path, typer.Option(help="Configuration file (TOML) of what was recorded.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write, never overwritten: .npz, .h5 or .mcap.")
    ],
    sensor: Annotated[str | None, typer.Option(help="Which, where the configuration has several.")] = None,
) -> None:
    """Restore every frame of a recording into a file of arrays, or into one for Foxglove."""
    settings = load(config)
    name = choose("sensor", sensor, settings.sensor)
    make = _free(out)
    began = time.perf_counter()
    with threadpool_limits(1):
        count, messages = _export(file, settings, config, name, out, make)
    took = time.perf_counter() - began
    Console(soft_wrap=True, highlight=False).print(
        f"{out}: {count} frames of {name} from {messages} in {took:.1f} s", markup=False
    )


def _free(out: Path) -> type[Sink]:
    """What writes a file of that name; ConfigError where it cannot be written."""
    if out.suffix not in FORMATS:
        raise ConfigError(f"{out}: unsupported format; use {', '.join(FORMATS)}")
    FORMATS[out.suffix].check()
    try:
        if out.exists():
            raise ConfigError(f"{out} {THERE}")
        if not out.parent.is_dir():
            raise ConfigError(f"{out}: no such directory: name a file that can be written")
    except OSError as error:
        raise ConfigError(f"{out}: {error.strerror}: name a file that can be written") from error
    return FORMATS[out.suffix]


def _export(file: Path, settings: Config, config: Path, name: str, out: Path, make: type[Sink]) -> tuple[int, str]:
    """Write the file; how many frames, and of what."""
    plan = sensor_plan(name, settings.sensor[name])
    beside = one_bus(settings, plan.bus).sensor
    router = Router({key: make_codec(each) for key, each in beside.items()})
    recording, count = Recording(file), 0
    try:
        with (
            TemporaryDirectory(prefix=".tactiled-", dir=out.parent) as room,
            whole(out) as part,
            make(part, Path(room), plan) as sink,
        ):
            for image in _images(_heard(recording, sink), router, plan):
                sink.image(image)
                count += 1
            if not count:
                raise ConfigError(f"recording {file}: holds no frame of sensor {name} ({recording.told()})")
            about = _about(recording, plan, router.assemblers[name].loss)
            sink.end(
                about | {"config": {"file": config.name} | settings.model_dump(mode="json", exclude={"server"})}
            )
    except FileExistsError as error:
        raise ConfigError(f"{out} {THERE}") from error
    except OSError as error:
        raise TactileError(f"{out}: {error.strerror or error}: nothing is exported") from error
    return count, recording.told()


def _heard(recording: Recording, sink: Sink) -> Iterator[Message]:
    """A recording's messages, each of which the sink gets too."""
    for message in recording:
        sink.message(message)
        yield message


def _images(messages: Iterator[Message], router: Router, plan: SensorPlan) -> Iterator[Image]:
    pipeline = Pipeline(plan.name, plan.array, plan.blur, plan.calibration, plan.method, plan.warnings)
    return (pipeline.process(frame) for name, frame in frames(messages, router) if name == plan.name)


def _digest(recording: Path) -> str:
    """SHA-256 of a recording."""
    try:
        with recording.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"recording {recording}: {error.strerror}") from error


def _about(recording: Recording, plan: SensorPlan, loss: Loss) -> dict[str, Any]:
    """Units and provenance."""
    return {
        "made_by": f"tactiled {__version__}",
        "recording": {
            "file": recording.path.name,
            "sha256": _digest(recording.path),
            "messages": recording.count,
            "end_cut_off": recording.torn,
        },
        "sensor": {"name": plan.name, "bus": plan.bus, "codec": plan.codec_name, "method": plan.method},
        "cover": {"model": plan.kernel.model, "gain_error": plan.kernel.error_estimate},
        "cell_mm": plan.cell_mm,
        "units": ({"shear": SHEAR} if plan.shears else {})
        | {
            "raw": "kPa",
            "restored": "kPa",
            "noise_kpa": "kPa, standard deviation of one raw taxel",
            "time": "s, on the recording's clock, of a frame's first message",
            "sequence": "counts up without wrapping, lost frames included",
            "positions_mm": "mm, (x, y) of the taxels, in the order of raw",
            "cells_mm": "mm, (x, y) of the surface cells, in the order of restored",
            "flags": "bits, as in flag_bits",
            "loss": "counts so far, by kind as in loss_kinds",
        },
        "flag_bits": FLAGS,
        "loss_kinds": LOSS,
        "loss": asdict(loss),
        "warnings": [asdict(each) for each in plan.warnings],
    }
