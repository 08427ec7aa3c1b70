"""Options that several verbs have, and what is checked of them alike."""

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import typer

from tactiled import logs
from tactiled.config import Buses, load, schema
from tactiled.errors import ConfigError
from tactiled.files import whole_file

Config = Annotated[Path, typer.Argument(help="Configuration file (TOML).")]
Recording = Annotated[Path, typer.Argument(help="Recording, in any format that python-can reads.")]
RecordedConfig = Annotated[Path, typer.Option("--config", help="Configuration file (TOML) of what was recorded.")]
Bus = Annotated[str | None, typer.Option(help="Bus of the configuration, if it has several.")]
Sensor = Annotated[str | None, typer.Option(help="Sensor of the configuration, if it has several.")]
Interface = Annotated[
    str | None, typer.Option(help="python-can's name of the interface: socketcan, slcan, udp_multicast, ...")
]
Channel = Annotated[str | None, typer.Option(help="Its channel: can0, /dev/ttyUSB0, 239.74.163.2, ...")]
Bitrate = Annotated[int | None, typer.Option(help="Bits a second, if the interface sets them.", min=1)]
Seconds = Annotated[float | None, typer.Option(help="How long; until interrupted if left out.", min=0)]
Rerun = Annotated[
    int | None,
    typer.Option(metavar="PORT", help="Show images in Rerun's viewer on this port (9876).", min=1, max=65535),
]
Foxglove = Annotated[
    int | None,
    typer.Option(metavar="PORT", help="Serve Foxglove's apps too, on this port of loopback.", min=0, max=65535),
]
LogFormat = Annotated[
    logs.Style,
    typer.Option(
        "--log-format", callback=logs.configure, envvar="TACTILED_LOG_FORMAT", help="Log for people or as JSON."
    ),
]


def choose(option: str, name: str | None, available: Collection[str]) -> str:
    """The one of `available` that --`option` names, or the only one there is; ConfigError otherwise."""
    if name is None and len(available) > 1:
        raise ConfigError(f"--{option} is missing: choose one of {', '.join(available)}")
    if name is not None and name not in available:
        raise ConfigError(f"--{option} {name}: no such {option}: choose one of {', '.join(available)}")
    return name or next(iter(available))


def one_sensor(config: Path, name: str | None) -> tuple[schema.Config, str, schema.Sensor]:
    """A configuration, and the sensor of it that --sensor names, or the only one."""
    settings = load(config)
    name = choose("sensor", name, settings.sensor)
    return settings, name, settings.sensor[name]


def present(**options: Any) -> dict[str, Any]:
    """Those options that are not None."""
    return {name: value for name, value in options.items() if value is not None}


def numbers(
    option: str, text: str, form: str = "numbers with commas between them", count: int | None = None
) -> list[float]:
    """Numbers with commas between them, `count` of them; ConfigError otherwise, which names their `form`."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"--{option} {text}: give {form}") from error
    if len(numbers) != (count or len(numbers)):
        raise ConfigError(f"--{option} {text}: give {form}")
    return numbers


def bus_settings(file: Buses | None, bus: str | None, keys: dict[str, Any]) -> dict[str, Any]:
    """What to open a bus with: as a file says, or by the options `keys`; ConfigError where both say it."""
    if file is not None:
        if keys:
            raise ConfigError(
                "--config: says how to open the bus: leave out --interface and the options beside it"
            )
        return file.bus[choose("bus", bus, file.bus)].settings()
    if bus is not None:
        raise ConfigError(f"--bus {bus}: give --config, the file that has this bus")
    return keys


def write_configuration(path: Path, text: str) -> None:
    """Write a new configuration and print what to do with it."""
    with whole_file(path) as part:
        part.write_text(text, "utf-8")
    typer.echo(f"wrote {path}: edit it, then `tactiled check {path}` and `tactiled run {path}`")
