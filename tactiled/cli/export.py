"""`tactiled export`: a recording's images as arrays with their units and provenance."""

import hashlib
import re
import time
from collections.abc import Iterator
from dataclasses import asdict, astuple, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from tactiled import __version__
from tactiled.bus.replay import Recording, frames
from tactiled.bus.router import Router
from tactiled.cli.app import app
from tactiled.cli.columns import Columns, writer
from tactiled.cli.replay import one_bus
from tactiled.config import Config, load
from tactiled.config.build import SensorPlan, make_codec, sensor_plan
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED, Image, Loss
from tactiled.pipeline import Pipeline

FLAGS = {"MISSING": MISSING, "BAD": BAD, "DEAD": DEAD, "SATURATED": SATURATED}
LOSS = tuple(each.name for each in fields(Loss))
METHOD = "<U16"  # longer than any method's name
SECRET = re.compile(
    r"""(?s)((?:read_token|control_token)["']?\s*=\s*)(""{2}.*?""{2}|'''.*?'''|"(?:\\.|[^"\\])*"|'[^']*')"""
)


@app.command()
def export(
    file: Annotated[Path, typer.Argument(help="Recording, in any format that python-can reads.")],
    config: Annotated[Path, typer.Option(help="Configuration file (TOML) of what was recorded.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write, never overwritten: .npz or .h5.")],
    sensor: Annotated[str | None, typer.Option(help="Which, where the configuration has several.")] = None,
) -> None:
    """Restore every frame of a recording, as fast as it goes, into one .npz or .h5 file."""
    settings = load(config)
    name = _sensor(settings, sensor)
    _free(out)
    began = time.perf_counter()
    with threadpool_limits(1):
        count, messages = _export(file, settings, config, name, out)
    took = time.perf_counter() - began
    Console(soft_wrap=True, highlight=False).print(
        f"{out}: {count} frames of {name} from {messages} in {took:.1f} s", markup=False
    )


def _sensor(settings: Config, name: str | None) -> str:
    """The sensor asked for, or the only one there is; ConfigError otherwise."""
    known = ", ".join(settings.sensor)
    if name is None and len(settings.sensor) > 1:
        raise ConfigError(f"--sensor is missing: choose one of {known}")
    if name is not None and name not in settings.sensor:
        raise ConfigError(f"--sensor {name}: no such sensor: choose one of {known}")
    return name or next(iter(settings.sensor))


def _free(out: Path) -> None:
    """Refuse a name that cannot be written."""
    writer(out)
    if out.exists():
        raise ConfigError(f"{out} is there already: name another file, or remove it first")
    if not out.parent.is_dir():
        raise ConfigError(f"{out}: no such directory: name a file that can be written")


def _export(file: Path, settings: Config, config: Path, name: str, out: Path) -> tuple[int, str]:
    """Write the file; how many frames, and of what."""
    plan = sensor_plan(name, settings.sensor[name])
    beside = one_bus(settings, plan.bus).sensor
    router = Router({key: make_codec(each) for key, each in beside.items()})
    recording = Recording(file)
    try:
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as room:
            columns = Columns(Path(room))
            for image in _images(recording, router, plan):
                columns.add(_row(image))
            if not columns.count:
                raise ConfigError(f"recording {file}: holds no frame of sensor {name} ({recording.told()})")
            about = _about(recording, plan, router.assemblers[name].loss) | {
                "config": {"file": config.name, "text": SECRET.sub(r'\1"..."', config.read_text("utf-8"))}
            }
            places = {"positions_mm": plan.array.positions, "cells_mm": plan.cells.positions}
            whole = Path(room) / "whole"
            writer(out)(columns, whole, places, about)
            whole.rename(out)
    except OSError as error:
        raise TactileError(f"{out}: {error.strerror or error}: nothing is exported") from error
    return columns.count, recording.told()


def _images(recording: Recording, router: Router, plan: SensorPlan) -> Iterator[Image]:
    pipeline = Pipeline(plan.name, plan.array, plan.blur, plan.calibration, plan.method, plan.warnings)
    return (pipeline.process(frame) for name, frame in frames(recording, router) if name == plan.name)


def _row(image: Image) -> dict[str, NDArray[Any]]:
    """What is kept of one frame."""
    return {
        "raw": image.raw.astype("<f4", copy=False),
        "restored": image.restored.astype("<f4", copy=False),
        "flags": image.flags,
        "time": np.array(image.time, "<f8"),
        "sequence": np.array(image.sequence, "<i8"),
        "method": np.array(image.method, METHOD),
        "noise_kpa": np.array(image.noise_kpa, "<f8"),
        "loss": np.array(astuple(image.loss), "<i8"),
    }


def _about(recording: Recording, plan: SensorPlan, loss: Loss) -> dict[str, Any]:
    """Units and provenance."""
    with recording.path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "made_by": f"tactiled {__version__}",
        "recording": {
            "file": recording.path.name,
            "sha256": digest,
            "messages": recording.count,
            "end_cut_off": recording.torn,
        },
        "sensor": {"name": plan.name, "bus": plan.bus, "codec": plan.codec_name, "method": plan.method},
        "cover": {"model": plan.kernel.model, "gain_error": plan.kernel.error_estimate},
        "cell_mm": plan.cell_mm,
        "units": {
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
        "warnings": plan.warnings,
    }
