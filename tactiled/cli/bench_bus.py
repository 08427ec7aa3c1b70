"""`tactiled bench bus`: how many CAN messages a second become frames."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from tactiled.study import bus as measure
from tactiled.study.machine import describe

CHANNEL = "tactiled-bench"  # of the virtual bus
LINKS, VCANS = Path("/sys/class/net"), ("vcan0", "vcan1")


def bus(
    interface: Annotated[
        str | None,
        typer.Option(help="Bus of the live measurement, by python-can's name; virtual and any vcan if left out."),
    ] = None,
    channel: Annotated[
        list[str] | None, typer.Option(help="Its channel, such as vcan0; may be given again for a further bus.")
    ] = None,
    rate: Annotated[float, typer.Option(help="Messages a second to send, over all of its buses.", min=1)] = 16_000,
    seconds: Annotated[float, typer.Option(help="How long to measure each figure.", min=0.01)] = 2.0,
) -> None:
    """Count the messages a second that are decoded and assembled, from memory and over a bus."""
    table = Table(title="CAN messages a second, one core, from memory", title_justify="left")
    for name in ("skin", "messages a frame", "decoded and assembled", "encoded", "aim"):
        table.add_column(name)
    for each in measure.offline(seconds):
        row = (str(each.segments), f"{each.received:,.0f}", f"{each.encoded:,.0f}", "200,000 decoded")
        table.add_row(each.skin, *row)
    console = Console()
    console.print(table)
    for buses in _buses(interface, channel):
        told = measure.live(buses, rate, seconds)
        busy = "unknown: processor time is told in coarse steps" if told.cores is None else f"{told.cores:.2f}"
        console.print(
            f"{told.label}: {told.sent:,} messages sent at {rate:,.0f}/s, {told.received:,} received at"
            f" {told.rate:,.0f}/s, {told.lost:,} counted as lost; cores busy reading: {busy}"
            " (aim: 16,000/s, none lost, under 0.6)",
            soft_wrap=True,
            highlight=False,
        )
    console.print(describe(), soft_wrap=True, highlight=False)


def _buses(interface: str | None, channels: list[str] | None) -> list[list[dict[str, str]]]:
    """The buses of each live measurement."""
    names = [CHANNEL] if channels is None else channels
    measured = [[{"interface": interface or "virtual", "channel": name} for name in names]]
    if interface is None and (vcans := [name for name in VCANS if (LINKS / name).exists()]):
        measured.append([{"interface": "socketcan", "channel": name} for name in vcans])
    return measured
