"""`tactiled export`: a recording's images with their units and provenance."""

import time
from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled.archive import export as archive
from tactiled.archive.writers import FORMATS, writer
from tactiled.build import make_codec, sensor_plan
from tactiled.bus.recording import Recording
from tactiled.cli import options
from tactiled.cli.replay import one_bus

FORMAT_HELP = f"File to write, never overwritten: {', '.join(name for name in FORMATS if name[0] == '.')}."
TO_HELP = f"Format: {', '.join(name.removeprefix('.') for name in FORMATS)}; left out: by the file's ending."


def export(
    file: options.Recording,
    config: options.RecordedConfig,
    out: Annotated[Path, typer.Option("--out", "-o", help=FORMAT_HELP)],
    sensor: options.Sensor = None,
    to: Annotated[str | None, typer.Option(help=TO_HELP)] = None,
) -> None:
    """Restore every frame of a recording into a file of arrays, or into one for Foxglove or ROS 2."""
    settings, name, one = options.one_sensor(config, sensor)
    make_writer = writer(str(out), to)
    began, recording = time.perf_counter(), Recording(file)
    with threadpool_limits(1), options.new_file(out) as part:
        plan = sensor_plan(name, one)
        codecs = {key: make_codec(each) for key, each in one_bus(settings, plan.bus).sensor.items()}
        dump = {"file": config.name} | settings.model_dump(mode="json", exclude={"server"})
        count = archive.export(recording, part, make_writer, plan, codecs, dump)
    typer.echo(
        f"{out}: {count} frames of {name} from {recording.summary()} in {time.perf_counter() - began:.1f} s"
    )
