"""`tactiled bench bus`: how many CAN messages a second become frames."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from tactiled.bench import bus as measure
from tactiled.bench.machine import describe
from tactiled.cli.app import bench


@bench.command()
def bus(
    interface: Annotated[str, typer.Option(help="Bus of the live measurement, by python-can's name.")] = "virtual",
    channel: Annotated[str, typer.Option(help="Its channel; vcan0 for SocketCAN's own.")] = "tactiled-bench",
    rate: Annotated[float, typer.Option(help="Messages a second to send on it.", min=1)] = 16_000,
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
    told = measure.live({"interface": interface, "channel": channel}, rate, seconds)
    whose = "reader and sender" if interface == "virtual" else "reader"
    console.print(
        f"{told.label}: {told.sent:,} messages sent at {rate:,.0f}/s, {told.received:,} received at"
        f" {told.rate:,.0f}/s, {told.lost:,} counted as lost; {whose} kept {told.cores:.2f} cores busy"
        " (aim: 16,000/s, none lost, under 0.6)",
        soft_wrap=True,
        highlight=False,
    )
    console.print(describe(), soft_wrap=True, highlight=False)
