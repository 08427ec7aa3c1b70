"""`tactiled sniff`: which skins speak on a bus, and a configuration for them."""

import json
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from tactiled.bus.reader import open_bus
from tactiled.bus.sniff import Found, Heard, recognise
from tactiled.cli.app import interrupted
from tactiled.cli.options import new_file
from tactiled.config import parse
from tactiled.errors import ConfigError
from tactiled.frames import Message

POLL_S = 0.05  # how long a read waits
MOST = 1_000_000  # messages, so that listening for long does not fill the memory
SHOWN = 8  # ids of no known skin
PITCH_MM = {"packed": 1.0}  # of arrays that say nothing of it; other skins' taxels are further apart
HEAD = """\
# Written by `tactiled sniff` from what was heard on the bus. What no bus can say is a guess: go through every line
# marked EDIT, then `tactiled check` this file.

[bus.{bus}]
{settings}
"""
SENSOR = """
# {says}: {taxels} taxels, {rate:.1f} frames a second.
[sensor.{name}]
bus = "{bus}"
method = "auto"

[sensor.{name}.codec]
{codec}
{array}
[sensor.{name}.cover]                  # EDIT: the rubber over the taxels
thickness_mm = 1.0
young_mpa = 0.5
poisson = 0.48

[sensor.{name}.calibration]
no_load = {no_load}  # median of what was heard: right if most of the array was not touched
# kpa_per_count = 0.05  # EDIT: without it one count is shown as one kPa
"""
ARRAY = """
[sensor.{name}.array]                  # EDIT: what the bus does not say
rows = {rows}
columns = {columns}
pitch_mm = {pitch}
"""


def sniff(
    interface: Annotated[
        str, typer.Option(help="python-can's name of the interface: socketcan, slcan, udp_multicast, ...")
    ] = "socketcan",
    channel: Annotated[
        str | None, typer.Option(help="Its channel; can0 on SocketCAN if left out.", show_default=False)
    ] = None,
    bitrate: Annotated[
        int | None, typer.Option(help="Bits a second, where the interface sets them.", min=1)
    ] = None,
    fd: Annotated[
        bool, typer.Option("--fd", help="Open the interface for CAN FD; SocketCAN's always is.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="How long to listen.", min=0.05, max=3600)] = 3.0,
    write: Annotated[
        Path | None, typer.Option(help="Configuration to write for what was found; never overwritten.")
    ] = None,
) -> None:
    """Listen to a bus and list the known skins on it; sends nothing."""
    if write is not None and write.exists():
        raise ConfigError(f"{write} is there already: name another file, or remove it first")
    given = {"channel": channel, "bitrate": bitrate, "fd": fd or None}
    settings = {key: value for key, value in given.items() if value is not None}
    if interface == "socketcan":
        settings = {"channel": "can0"} | settings | {"fd": True}
    messages = _listen({"interface": interface} | settings, seconds)
    heard = recognise(messages)
    console = Console(soft_wrap=True, highlight=False)
    for line in report(heard, len(messages), seconds):
        console.print(line, markup=False)
    if write is not None:
        _write(write, configuration(heard, {"interface": interface} | settings))
        console.print(
            f"wrote {write}: edit it, then `tactiled check {write}` and `tactiled run {write}`", markup=False
        )


def _listen(settings: dict[str, Any], seconds: float) -> list[Message]:
    """What the bus carries in so many seconds, or until Ctrl-C."""
    reader = open_bus(**settings)
    heard: list[Message] = []
    try:
        with interrupted() as stop:
            end = time.monotonic() + seconds
            while not stop.is_set() and (left := end - time.monotonic()) > 0 and len(heard) < MOST:
                if (message := reader.receive(min(left, POLL_S))) is not None:
                    heard.append(message)
    finally:
        reader.close()
    return heard


def report(heard: Heard, count: int, seconds: float) -> list[str]:
    """What to tell a person, line by line."""
    lines = [f"{count} messages in {seconds:g} s"]
    for one in heard.found:
        ids = _ids(one)
        lost = f", {one.lost} messages lost" if one.lost else ""
        lines.append(
            f"{one.says}: {one.made.size} taxels, {one.made.segments} messages a frame on {ids},"
            f" {one.rate_hz:.1f} frames a second{lost}"
        )
        lines += [f"  {doubt}" for doubt in one.doubts]
    if not heard.found:
        lines.append(
            "no known skin: some are silent until started (iCub, XELA's older boards) or asked (LinkerHand)"
        )
    for other in heard.others[:SHOWN]:
        width = 8 if other.extended else 3
        lines.append(f"unknown id {other.id:0{width}x}: {other.messages} messages, {other.rate_hz:.1f} a second")
    if len(heard.others) > SHOWN:
        lines.append(f"and {len(heard.others) - SHOWN} unknown ids more")
    return lines


def _ids(one: Found) -> str:
    shown = [f"{id_:#x}" for id_, _ in one.keys]
    return f"id {shown[0]}" if len(shown) == 1 else f"ids {shown[0]} to {shown[-1]}"


def configuration(heard: Heard, settings: dict[str, Any]) -> str:
    """A configuration of everything found, as TOML; ConfigError where nothing was."""
    if not heard.found:
        raise ConfigError("no known skin was heard: nothing to write a configuration for")
    bus = str(settings.get("channel", ""))
    bus = bus if bus.isalnum() and bus.isascii() and len(bus) <= 64 else "can0"
    text = HEAD.format(bus=bus, settings=_lines(settings))
    names: list[str] = []
    for one in heard.found:
        kind = str(one.codec["name"])
        name = f"{kind}{1 + sum(each.startswith(kind) for each in names)}"
        names.append(name)
        text += _sensor(one, name, bus)
    parse(text, "sniffed")  # what is written can be read
    return text


def _sensor(one: Found, name: str, bus: str) -> str:
    array = ""
    if one.shape is not None:
        pitch = PITCH_MM.get(one.codec["name"], 4.0)
        array = ARRAY.format(name=name, rows=one.shape[0], columns=one.shape[1], pitch=pitch)
    codec = _lines(one.codec) + "".join(f"\n# {doubt}" for doubt in one.doubts)
    return SENSOR.format(
        name=name,
        bus=bus,
        says=one.says,
        taxels=one.made.size,
        rate=one.rate_hz,
        codec=codec,
        array=array,
        no_load=one.no_load,
    )


def _lines(settings: dict[str, Any]) -> str:
    """Keys and values in TOML, whose strings, numbers, booleans and lists of them are JSON's."""
    return "\n".join(f"{key} = {json.dumps(value)}" for key, value in settings.items())


def _write(path: Path, text: str) -> None:
    with new_file(path) as part:
        part.write_text(text, "utf-8")
