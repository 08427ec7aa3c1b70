"""`tactiled export`: a recording's images as arrays with their units and provenance."""

import hashlib
import json
import re
import shutil
import time
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, astuple, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, BinaryIO

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from tactiled import __version__
from tactiled.bus.replay import Recording, frames
from tactiled.bus.router import Router
from tactiled.cli.app import app
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
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write, never overwritten: .npz.")],
    sensor: Annotated[str | None, typer.Option(help="Which, where the configuration has several.")] = None,
) -> None:
    """Restore every frame of a recording, as fast as it goes, into one .npz file."""
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
    if out.suffix != ".npz":
        raise ConfigError(f"{out}: no format of exports: let its name end in .npz")
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
            whole = {
                "positions_mm": plan.array.positions,
                "cells_mm": plan.cells.positions,
                "provenance": np.array(json.dumps(about, indent=1)),
            }
            columns.save(Path(room) / "npz", whole)
            (Path(room) / "npz").rename(out)
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


class Columns:
    """Arrays that grow by a frame at a time, on the disk, so that a long recording needs no memory."""

    def __init__(self, room: Path) -> None:
        self._room = room
        self._open: dict[str, BinaryIO] = {}
        self._forms: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
        self._closing = ExitStack()
        self.count = 0

    def add(self, row: dict[str, NDArray[Any]]) -> None:
        """Append one frame."""
        for name, array in row.items():
            if name not in self._open:
                self._open[name] = self._closing.enter_context((self._room / name).open("wb"))
                self._forms[name] = array.dtype, array.shape
            self._open[name].write(array.tobytes())
        self.count += 1

    def save(self, path: Path, whole: dict[str, NDArray[Any]]) -> None:
        """Write everything, and the arrays `whole` that are not by frame, as numpy's .npz."""
        self._closing.close()
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, (dtype, shape) in self._forms.items():
                with _entry(archive, name) as entry, (self._room / name).open("rb") as column:
                    _header(entry, dtype, (self.count, *shape))
                    shutil.copyfileobj(column, entry, 1 << 20)
            for name, array in whole.items():
                with _entry(archive, name) as entry:
                    np.lib.format.write_array(entry, array, allow_pickle=False)


def _entry(archive: zipfile.ZipFile, name: str) -> Any:
    """A new member; its date is not today's, so that the same export is the same file."""
    return archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True)


def _header(entry: Any, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    told = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(entry, told)
