"""`tactiled record`: a bus's raw traffic into a file."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from tactiled.bus.reader import open_bus
from tactiled.bus.recorder import Recorder
from tactiled.bus.recorder import record as record_bus
from tactiled.cli import options
from tactiled.cli.app import interrupted
from tactiled.config import Server, load_buses
from tactiled.errors import ConfigError


def record(
    out: Annotated[
        Path, typer.Argument(help="File to write, never overwritten: .log, .asc, .blf, .log.gz, .asc.gz.")
    ],
    config: Annotated[Path | None, typer.Option(help="Record a bus of this file.")] = None,
    bus: options.Bus = None,
    interface: options.Interface = None,
    channel: options.Channel = None,
    bitrate: options.Bitrate = None,
    fd: Annotated[bool, typer.Option("--fd", help="Open the interface for CAN FD.")] = False,
    seconds: options.Seconds = None,
    leave_mb: Annotated[
        float | None,
        typer.Option(
            "--recordings-leave-mb",
            help="End with so much of the disk free (0: no bound); the file's, or 1000, if left out.",
            min=0,
        ),
    ] = None,
) -> None:
    """Record all messages of a bus to a file, also of other devices, and error frames."""
    settings = load_buses(config) if config else None
    keys = options.present(interface=interface, channel=channel, bitrate=bitrate, fd=fd or None)
    if settings is None and interface is None:
        raise ConfigError("--interface is missing: give python-can's name, such as socketcan, or a --config")
    if leave_mb is None:
        leave_mb = (settings.server if settings else Server()).recordings_leave_mb
    with closing(open_bus(**options.bus_settings(settings, bus, keys))) as reader, interrupted() as stop:
        recorder = Recorder(out, leave_mb=leave_mb)
        typer.echo(f"{reader.label}: recording to {out}: press Ctrl-C to stop")
        written = record_bus(reader, recorder, stop, float("inf") if seconds is None else seconds)
    unreadable = f", and {reader.unreadable} that could not be decoded" if reader.unreadable else ""
    typer.echo(f"{out}: {written} messages{unreadable}")
