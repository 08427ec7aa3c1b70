"""`tactiled sniff`: which skins send on a bus, and a configuration for them."""

import time
from collections import Counter
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import typer

from tactiled.bus.codec import setting_text
from tactiled.bus.reader import open_bus
from tactiled.bus.recording import Recording
from tactiled.bus.skins import load
from tactiled.bus.sniff import Sender, Survey, survey
from tactiled.cli import options
from tactiled.cli.app import interrupted
from tactiled.config import load_buses, parse, ready
from tactiled.errors import ConfigError
from tactiled.frames import Message

READ_S = 0.05  # how long a read waits: bounds how late Ctrl-C is seen
MAX_MESSAGES = 1_000_000  # so that listening for long does not fill the memory
MAX_UNKNOWN_LISTED = 8
HEAD = """\
# Written by `tactiled sniff` from the messages on the bus. What no bus can tell is a guess: go through every line
# marked EDIT and delete the mark, then `tactiled check` this file.

[bus.{bus}]
{settings}
"""
SENSOR = """
# {match.description}: {match.codec.size} taxels, {one.rate_hz:.1f} frames a second.
[sensor.{name}]
bus = "{bus}"
method = "auto"
{refine}
[sensor.{name}.codec]
{codec}
{array}
[sensor.{name}.cover]                  # EDIT: the rubber over the taxels
thickness_mm = 1.0
young_mpa = 0.5
poisson = 0.48

[sensor.{name}.calibration]
no_load = {one.no_load}  # median of what came: right if most of the array was not touched
# kpa_per_count = {sign}0.05  # EDIT: without it pressure is in counts
"""
ARRAY = """
[sensor.{name}.array]                  # EDIT: what the bus does not tell
rows = {rows}
columns = {columns}
pitch_mm = {pitch_mm}
"""


def sniff(
    file: Annotated[
        Path | None, typer.Argument(help="Recording to look into instead of a bus.", show_default=False)
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Listen to a bus of this file, which need not have a sensor.")
    ] = None,
    bus: options.Bus = None,
    interface: Annotated[
        str | None,
        typer.Option(help="python-can's name of the interface: slcan, udp_multicast, ...; socketcan if left out."),
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Its channel; can0 on SocketCAN if left out.", show_default=False)
    ] = None,
    bitrate: options.Bitrate = None,
    fd: Annotated[
        bool, typer.Option("--fd", help="Open the interface for CAN FD; SocketCAN's always is.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="How long to listen.", min=0.05, max=3600)] = 3.0,
    write: Annotated[
        Path | None, typer.Option(help="Configuration to write for what was found; never overwritten.")
    ] = None,
) -> None:
    """List the known skins on a bus, or in a recording; sends nothing."""
    if write is not None and write.exists():
        raise ConfigError(f"{write} is there already: name another file, or remove it first")
    keys = options.present(interface=interface, channel=channel, bitrate=bitrate, fd=fd or None)
    settings = options.bus_settings(load_buses(config) if config else None, bus, keys)
    if config is None and interface in (None, "socketcan"):
        settings = {"interface": "socketcan", "channel": "can0"} | settings | {"fd": True}
    if file is None:
        messages, _ = listen(settings, seconds)
        count = f"{len(messages)} messages in {seconds:g} s"
    elif config is not None or keys:
        raise ConfigError(f"{file}: leave out --config, --interface and the options beside it: no bus is opened")
    else:
        messages, count = recorded(file)
    result = survey(messages)
    typer.echo("\n".join(report(result, count)))
    if write is not None:
        options.write_configuration(write, configuration(result, settings))


def listen(settings: dict[str, Any], seconds: float) -> tuple[list[Message], dict[str, int]]:
    """The messages on a bus in so many seconds, or until Ctrl-C, and its error frames by kind."""
    messages: list[Message] = []
    with closing(open_bus(**settings)) as reader, interrupted() as stop:
        end = time.monotonic() + seconds
        while not stop.is_set() and (rest := end - time.monotonic()) > 0 and len(messages) < MAX_MESSAGES:
            messages += reader.batch(min(rest, READ_S))
    return messages, {kind: count for kind, count in reader.kinds.items() if count}


def recorded(file: Path) -> tuple[list[Message], str]:
    """The first messages of a recording, and what else it has; ConfigError where two buses are mixed in it."""
    recording = Recording(file)
    messages = list(islice(recording, MAX_MESSAGES))
    ids = frozenset((each.id, each.extended) for each in messages)
    for _ in islice(Recording(file, ids), MAX_MESSAGES):
        pass
    return messages, f"{recording.summary()} in {recording.pace.now:.3g} s"


def report(result: Survey, count: str) -> list[str]:
    """What to tell a person, line by line; `count` is what came."""
    lines = [count, *survey_lines(result)]
    if not result.senders:
        lines.insert(
            1, "no known skin: some are silent until started (iCub, XELA's older boards) or asked (hands)"
        )
        if result.unknown:
            lines.append(
                'if a skin sends these: codec.name = "dbc" reads what a DBC file describes, a codec of your own '
                "the rest: see the guide, Codecs"
            )
    return lines


def survey_lines(result: Survey) -> list[str]:
    """Known skins, then unknown ids."""
    lines = []
    for one in result.senders:
        match, lost = one.match, f", {one.lost} messages lost" if one.lost else ""
        ids = [f"{id_:#x}" for id_, _ in match.keys]
        on = f"id {ids[0]}" if len(ids) == 1 else f"ids {ids[0]} to {ids[-1]}"
        size = f"{match.codec.size} taxels, {match.codec.segments} messages a frame on {on}"
        lines.append(f"{match.description}: {size}, {one.rate_hz:.1f} frames a second{lost}")
        lines += [f"  {note}" for note in match.notes]
    for each in result.unknown[:MAX_UNKNOWN_LISTED]:
        width = 10 if each.extended else 5
        lines.append(f"unknown id {each.id:#0{width}x}: {each.messages} messages, {each.rate_hz:.1f} a second")
    if (more := len(result.unknown) - MAX_UNKNOWN_LISTED) > 0:
        lines.append(f"and {more} unknown ids more")
    return lines


def configuration(result: Survey, settings: dict[str, Any]) -> str:
    """A configuration of every sender, as TOML; ConfigError if none was recognised."""
    if not result.senders:
        raise ConfigError("no known skin sends on this bus: nothing to write a configuration for")
    bus = str(settings.get("channel", ""))
    bus = bus if bus.isalnum() and bus.isascii() and len(bus) <= 64 else "can0"
    text = HEAD.format(bus=bus, settings=_lines(settings))
    numbers: Counter[str] = Counter()
    for one in result.senders:
        numbers[one.name] += 1
        text += _sensor(one, f"{one.name}{numbers[one.name]}", bus)
    parse(text, "sniffed")  # what is written can be read
    return text


def _sensor(one: Sender, name: str, bus: str) -> str:
    match, array, refine = one.match, "", ready.fine(one.match.shape)
    refine += "\n" if refine else ""
    if match.shape is not None:
        rows, columns = match.shape
        array = ARRAY.format(name=name, rows=rows, columns=columns, pitch_mm=match.pitch_mm)
    codec = _lines({"name": one.name} | match.settings) + "".join(f"\n# {note}" for note in match.notes)
    sign = "-" if (load(one.name).kpa_per_count or 0) < 0 else ""  # counts that fall under pressure
    return SENSOR.format(
        name=name, bus=bus, one=one, match=match, codec=codec, array=array, refine=refine, sign=sign
    )


def _lines(settings: dict[str, Any]) -> str:
    """Keys and values in TOML."""
    return "\n".join(f"{key} = {setting_text(key, value)}" for key, value in settings.items())
