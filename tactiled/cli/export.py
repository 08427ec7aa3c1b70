"""`tactiled export`: a recording's images with their units and provenance."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from threadpoolctl import threadpool_limits

from tactiled import __version__
from tactiled.build import SensorPlan, make_codec, sensor_plan
from tactiled.bus.recording import Recording
from tactiled.bus.replay import frames
from tactiled.bus.router import Router
from tactiled.cli import options
from tactiled.cli.export_arrays import LOSS_KINDS, Hdf5Export, NpzExport
from tactiled.cli.export_mcap import McapExport
from tactiled.cli.replay import one_bus
from tactiled.config import Config
from tactiled.errors import ConfigError
from tactiled.frames import FLAG_BITS, Message
from tactiled.runtime.pipeline import Pipeline
from tactiled.units import LENGTH, PRESSURE

Export = NpzExport | Hdf5Export | McapExport
FORMATS: dict[str, type[Export]] = {".npz": NpzExport, ".h5": Hdf5Export, ".mcap": McapExport}
EXTRAS = {".h5": ("hdf5", ["h5py"]), ".mcap": ("foxglove", ["mcap", "foxglove"])}  # and their packages
SHEAR = "counts from the skin's nominal rest, (x, y) along its own axes; as sensed, neither restored nor tared"
UNITS = {
    "time": "s, on the recording's clock, of a frame's first message",
    "sequence": "counts up without wrapping, lost frames included",
    "positions_mm": f"{LENGTH}, (x, y) of the taxels, in the order of raw",
    "cells_mm": f"{LENGTH}, (x, y) of the surface cells, in the order of restored",
    "flags": "bits, as in flag_bits",
    "loss": "counts so far, by kind as in loss_kinds",
}


def export(
    file: options.Recording,
    config: options.RecordedConfig,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write, never overwritten: .npz, .h5 or .mcap.")
    ],
    sensor: options.Sensor = None,
) -> None:
    """Restore every frame of a recording into a file of arrays, or into one for Foxglove."""
    settings, name, one = options.one_sensor(config, sensor)
    if out.suffix not in FORMATS:
        raise ConfigError(f"{out}: unsupported format; use {', '.join(FORMATS)}")
    extra, packages = EXTRAS.get(out.suffix, ("", []))
    for package in packages:
        if not find_spec(package):
            raise ConfigError(
                f"--out: {out.suffix} needs {package}: pip install 'tactiled[{extra}]', or export to .npz"
            )
    began, recording = time.perf_counter(), Recording(file)
    with (
        threadpool_limits(1),
        options.new_file(out) as part,
        TemporaryDirectory(prefix=".tactiled-", dir=out.parent) as folder,
    ):
        plan = sensor_plan(name, one)
        with closing(FORMATS[out.suffix](part, Path(folder), plan)) as target:
            count = _fill(target, recording, plan, settings, config)
    typer.echo(
        f"{out}: {count} frames of {name} from {recording.summary()} in {time.perf_counter() - began:.1f} s"
    )


def _fill(target: Export, recording: Recording, plan: SensorPlan, settings: Config, config: Path) -> int:
    """Write everything; returns the number of frames."""
    neighbours = one_bus(settings, plan.bus).sensor
    router = Router({key: make_codec(each) for key, each in neighbours.items()})
    pipeline, count = Pipeline(plan), 0
    for name, frame in frames(_tapped(recording, target.add_message), router):
        if name == plan.name:
            target.add_image(pipeline.process(frame))
            count += 1
    if not count:
        where = f"recording {recording.path}"
        raise ConfigError(f"{where}: holds no frame of sensor {plan.name} ({recording.summary()})")
    provenance = _provenance(recording, plan) | {"loss": asdict(router.assemblers[plan.name].loss)}
    provenance["config"] = {"file": config.name} | settings.model_dump(mode="json", exclude={"server"})
    target.finish(provenance)
    return count


def _tapped(recording: Recording, tap: Callable[[Message], None]) -> Iterator[Message]:
    """A recording's messages, each of which `tap` gets first."""
    for message in recording:
        tap(message)
        yield message


def _units(plan: SensorPlan) -> dict[str, str]:
    """Unit of each array; pressure is in counts where the sensor is uncalibrated."""
    noise = f"{plan.unit}, standard deviation of one raw taxel"
    pressures = {"raw": plan.unit, "restored": plan.unit, "noise": noise}
    calibrated = {"noise_kpa": noise} if plan.unit == PRESSURE else {}
    return pressures | calibrated | UNITS | ({"shear": SHEAR} if plan.shears else {})


def _provenance(recording: Recording, plan: SensorPlan) -> dict[str, Any]:
    """Where the arrays come from, and their units."""
    return {
        "made_by": f"tactiled {__version__}",
        "recording": {
            "file": recording.path.name,
            "sha256": options.file_sha256(recording.path),
            "messages": recording.count,
            "end_cut_off": recording.torn,
        },
        "sensor": {"name": plan.name, "bus": plan.bus, "codec": plan.codec_name, "method": plan.method},
        "calibration": plan.calibration_id,
        "cover": {"model": plan.kernel.model, "gain_error": plan.kernel.error_estimate},
        "cell_mm": plan.cell_mm,
        "units": _units(plan),
        "flag_bits": FLAG_BITS,
        "loss_kinds": LOSS_KINDS,
        "warnings": [asdict(each) for each in plan.warnings],
    }
