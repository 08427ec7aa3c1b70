"""`tactiled export`: images of recordings with their units and provenance."""

import time
from typing import Annotated
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import typer
from threadpoolctl import threadpool_limits

from tactiled.archive.export import ExportJob
from tactiled.archive.writers import FORMATS, writer
from tactiled.bus.logfile import WRITERS
from tactiled.cli import batch, options
from tactiled.errors import ConfigError
from tactiled.live.state_file import StateFile

ENDINGS = ", ".join(name for name in FORMATS if name[0] == ".")
TO_HELP = f"Format: {', '.join(name.removeprefix('.') for name in FORMATS)}; left out: by the file's ending."

ZONE_HELP = "Time zone, such as Europe/Berlin, of recordings that do not say theirs (other tools' .blf, .trc)."


def export(
    recordings: Annotated[list[str], typer.Argument(help=f"Recordings: {batch.INPUTS}.")],
    config: options.RecordedConfig,
    out: Annotated[
        str, typer.Option("--out", "-o", help=f"File to write, never overwritten: {ENDINGS}; {batch.OUT}.")
    ],
    sensor: options.Sensor = None,
    to: Annotated[str | None, typer.Option(help=TO_HELP)] = None,
    zone: Annotated[str | None, typer.Option(help=ZONE_HELP)] = None,
    workers: batch.Workers = None,
    scheduler: batch.Scheduler = None,
) -> None:
    """Restore every frame of recordings into arrays, tables, or files for Foxglove, ROS 2 or Rerun."""
    settings, name, _ = options.one_sensor(config, sensor)
    state = StateFile.of(config, settings.server.state)
    regions = state.regions.get(name, {})
    job = ExportJob.of(config, settings, name, to=to, regions=regions, zone=_checked(zone))
    writer(out, to)
    if not (one := batch.single(recordings, out, workers, scheduler)):
        batch.run_batch(job, recordings, tuple(WRITERS), out, workers, scheduler)
        return
    began, (source, target) = time.perf_counter(), one
    with threadpool_limits(1), target.written(replace=False) as part, source.local() as path:
        text = job.make(path, part)
    typer.echo(f"{target}: {text} in {time.perf_counter() - began:.1f} s")


def _checked(zone: str | None) -> str | None:
    """A time zone's name, if this machine knows it; ConfigError."""
    if zone is not None:
        try:
            ZoneInfo(zone)
        except (OSError, ValueError, ZoneInfoNotFoundError) as error:
            raise ConfigError(f"--zone {zone}: no such time zone: give one such as Europe/Berlin") from error
    return zone
