"""`tactiled simulate`: an array under a cover that is not there, on any bus that python-can knows."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from tactiled.build import make_array, make_calibration, make_codec, make_stack
from tactiled.bus.codecs import talk_of
from tactiled.bus.reader import open_bus
from tactiled.cli.app import choose, interrupted
from tactiled.config import Config, Sensor, load, parse
from tactiled.config.codecs import Packed
from tactiled.config.example import EXAMPLE
from tactiled.cover.kernel import solve
from tactiled.errors import ConfigError
from tactiled.simulate import SCENES, Player, answer, play, player


def simulate(
    interface: Annotated[
        str | None, typer.Option(help="python-can's name of the interface: socketcan, slcan, udp_multicast, ...")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Its channel: can0, /dev/pts/3, 239.74.163.2, ...")] = None,
    bitrate: Annotated[
        int | None, typer.Option(help="Bits a second, where the interface sets them.", min=1)
    ] = None,
    fd: Annotated[
        bool | None, typer.Option("--fd/--classic", help="CAN FD messages or classic ones instead of the codec's.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Simulate a sensor of this file, on its bus unless --interface is given.")
    ] = None,
    sensor: Annotated[str | None, typer.Option(help="Which, where the file has several.")] = None,
    scene: Annotated[str, typer.Option(help="What touches it: tour, " + ", ".join(SCENES) + ".")] = "tour",
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=0.01, max=10_000)] = 100.0,
    seconds: Annotated[float | None, typer.Option(help="How long; until interrupted if left out.", min=0)] = None,
    noise_kpa: Annotated[float, typer.Option(help="Standard deviation of one taxel.", min=0)] = 0.1,
) -> None:
    """Simulate a covered array on a bus (32 x 32 without --config)."""
    settings = load(config) if config else parse(EXAMPLE, "example")
    name, one = _chosen(settings, sensor, fd)
    bus = _bus(settings, one, interface, {"channel": channel, "bitrate": bitrate}, own=config is not None)
    source = _player(one, scene, noise_kpa)
    sender = open_bus(**bus)
    console = Console(soft_wrap=True, highlight=False)
    polled = bool(talk_of(source.codec).polls)
    pace = "whenever it is asked" if polled else f"at {rate_hz:g} Hz"
    console.print(f"{name}: {scene} on {sender.label} {pace}: press Ctrl-C to stop", markup=False)
    began = time.monotonic()
    try:
        with threadpool_limits(1), interrupted() as stop:
            long = float("inf") if seconds is None else seconds
            if polled:
                sent = answer(source, sender.receive, sender.send, stop, long)
            else:
                sent = play(source.messages, sender.send, rate_hz, stop, long)
    finally:
        sender.close()
    took = time.monotonic() - began
    done = f"answered {sent} requests" if polled else f"sent {sent} frames of {source.codec.segments} messages"
    console.print(f"{done} in {took:.1f} s", markup=False)


def _chosen(settings: Config, name: str | None, fd: bool | None) -> tuple[str, Sensor]:
    """The sensor asked for, with the kind of message asked for; ConfigError where there is none such."""
    name = choose("sensor", name, settings.sensor)
    one = settings.sensor[name]
    if fd is None:
        return name, one
    if isinstance(one.codec, Packed):
        return name, one.model_copy(update={"codec": one.codec.model_copy(update={"fd": fd})})
    if fd:
        raise ConfigError(f"--fd: sensor {name} speaks {one.codec.name}, which is classic CAN")
    return name, one


def _bus(
    settings: Config, one: Sensor, interface: str | None, options: dict[str, Any], *, own: bool
) -> dict[str, Any]:
    """What to open the bus with: the options, over the file's own bus if it is that one; CAN FD if need be."""
    given = {key: value for key, value in options.items() if value is not None}
    if interface is None and not own:
        raise ConfigError("--interface is missing: give python-can's name, such as socketcan, or a --config")
    base = {"interface": interface} if interface else settings.bus[one.bus].settings()
    if isinstance(one.codec, Packed) and one.codec.fd:
        given["fd"] = True
    return base | given


def _player(one: Sensor, scene: str, noise_kpa: float) -> Player:
    """The cover solved exactly, which is not the kernel that restores."""
    exact = solve(make_stack(one), "layered")
    return player(make_array(one), exact, make_codec(one), make_calibration(one), scene, noise_kpa)
