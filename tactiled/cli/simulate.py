"""`tactiled simulate`: a covered array that is only computed, on any bus that python-can opens."""

import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from threadpoolctl import threadpool_limits

from tactiled.build import configured_file, make_array, make_calibration, make_codec, make_stack
from tactiled.bus.codecs.packed import Settings as Packed
from tactiled.bus.reader import open_bus
from tactiled.cli import options
from tactiled.cli.app import interrupted
from tactiled.config import Config, Sensor, load, parse
from tactiled.config.example import EXAMPLE
from tactiled.cover.kernel import solve
from tactiled.errors import ConfigError
from tactiled.simulate import SCENES, Player, answer, play, player


def simulate(
    interface: options.Interface = None,
    channel: options.Channel = None,
    bitrate: options.Bitrate = None,
    fd: Annotated[
        bool | None, typer.Option("--fd/--classic", help="CAN FD messages or classic ones instead of the codec's.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Simulate a sensor of this file, on its bus unless --interface is given.")
    ] = None,
    sensor: options.Sensor = None,
    scene: Annotated[str, typer.Option(help="What touches it: tour, " + ", ".join(SCENES) + ".")] = "tour",
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=0.01, max=10_000)] = 100.0,
    seconds: options.Seconds = None,
    noise_kpa: Annotated[float, typer.Option(help="Standard deviation of one taxel.", min=0)] = 0.1,
) -> None:
    """Simulate a covered array on a bus (32 x 32 without --config)."""
    if interface is None and config is None:
        raise ConfigError("--interface is missing: give python-can's name, such as socketcan, or a --config")
    settings = load(config) if config else parse(EXAMPLE, "example")
    name = options.choose("sensor", sensor, settings.sensor)
    one = _with_fd(settings.sensor[name], name, fd)
    if one.codec.name == "pushed":
        raise ConfigError(f"sensor {name}: has no bus: its frames are pushed into a running service")
    source = simulated(one, scene, noise_kpa)
    keys = options.present(channel=channel, bitrate=bitrate)
    sender = open_bus(**_bus(settings, one, interface) | keys)
    polled = bool(source.codec.polling.polls)
    pace = "whenever it is asked" if polled else f"at {rate_hz:g} Hz"
    typer.echo(f"{name}: {scene} on {sender.label} {pace}: press Ctrl-C to stop")
    began, limit_s = time.monotonic(), float("inf") if seconds is None else seconds
    with closing(sender), threadpool_limits(1), interrupted() as stop:
        if polled:
            count = answer(source, sender.receive, sender.send, stop, limit_s)
        else:
            count = play(source.messages, sender.send, rate_hz, stop, limit_s)
    done = f"answered {count} requests" if polled else f"sent {count} frames of {source.codec.segments} messages"
    typer.echo(f"{done} in {time.monotonic() - began:.1f} s")


def _with_fd(sensor: Sensor, name: str, fd: bool | None) -> Sensor:
    """The sensor with CAN FD on or off; ConfigError where its codec is classic CAN only."""
    if isinstance(packed := sensor.codec.settings, Packed):
        codec = sensor.codec.model_copy(update={"settings": replace(packed, **options.present(fd=fd))})
        return sensor.model_copy(update={"codec": codec})
    if fd:
        raise ConfigError(f"--fd: sensor {name} speaks {sensor.codec.name}, which is classic CAN")
    return sensor


def _bus(settings: Config, sensor: Sensor, interface: str | None) -> dict[str, Any]:
    """What to open the bus with: the option or the file's own bus; CAN FD if the codec needs it."""
    bus = {"interface": interface} if interface else settings.bus[sensor.bus].settings()
    return bus | {"fd": True} if isinstance(sensor.codec.settings, Packed) and sensor.codec.settings.fd else bus


def simulated(sensor: Sensor, scene: str, noise_kpa: float) -> Player:
    """A scene under the cover as the exact solution has it, which is not the kernel that restores."""
    exact = solve(make_stack(sensor), "layered")
    calibration = make_calibration(sensor, configured_file(sensor))
    return player(make_array(sensor), exact, make_codec(sensor), calibration, scene, noise_kpa)
