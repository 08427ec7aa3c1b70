"""`tactiled record`: a bus's raw traffic into a file."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from tactiled.bus.recorder import Recorder, open_tap
from tactiled.bus.recorder import record as record_bus
from tactiled.cli.app import choose, interrupted
from tactiled.config import Config, Server, load
from tactiled.errors import ConfigError


def record(
    out: Annotated[
        Path, typer.Argument(help="File to write, never overwritten: .log, .asc, .blf, .log.gz, .asc.gz.")
    ],
    config: Annotated[Path | None, typer.Option(help="Record a bus of this file.")] = None,
    bus: Annotated[str | None, typer.Option(help="Which, where the file has several.")] = None,
    interface: Annotated[
        str | None, typer.Option(help="Or python-can's name of an interface: socketcan, slcan, udp_multicast, ...")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Its channel: can0, /dev/ttyUSB0, 239.74.163.2, ...")] = None,
    bitrate: Annotated[
        int | None, typer.Option(help="Bits a second, where the interface sets them.", min=1)
    ] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Open the interface for CAN FD.")] = False,
    seconds: Annotated[float | None, typer.Option(help="How long; until interrupted if left out.", min=0)] = None,
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
    given = {"channel": channel, "bitrate": bitrate, "fd": fd or None}
    read = load(config) if config else None
    settings = bus_settings(read, bus, interface, given)
    if leave_mb is None:
        leave_mb = (read.server if read else Server()).recordings_leave_mb
    console = Console(soft_wrap=True, highlight=False)
    tap = open_tap(**settings)
    try:
        with interrupted() as stop:
            recorder = Recorder(out, leave_mb=leave_mb)
            console.print(f"{tap.label}: recording to {out}: press Ctrl-C to stop", markup=False)
            written = record_bus(tap, recorder, stop, float("inf") if seconds is None else seconds)
    finally:
        tap.close()
    missed = f", and {tap.unreadable} that could not be decoded" if tap.unreadable else ""
    console.print(f"{out}: {written} messages{missed}", markup=False)


def bus_settings(
    config: Config | None, bus: str | None, interface: str | None, given: dict[str, Any]
) -> dict[str, Any]:
    """What to open a bus with: a file's, or that of the options; ConfigError where neither or both say which."""
    options = {key: value for key, value in given.items() if value is not None}
    if config is None:
        if interface is None:
            raise ConfigError("--interface is missing: give python-can's name, such as socketcan, or a --config")
        if bus is not None:
            raise ConfigError(f"--bus {bus}: names a bus of a --config, and there is none")
        return {"interface": interface} | options
    if interface is not None or options:
        raise ConfigError("--config: says how to open the bus: leave out --interface and the options beside it")
    return config.bus[choose("bus", bus, config.bus)].settings()
