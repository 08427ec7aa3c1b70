"""`tactiled bench latency`: how old an image is when a client has it."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.bench.latency import Latency, measure
from tactiled.bench.machine import describe
from tactiled.cli.app import bench
from tactiled.cli.demo import demo_config, simulated
from tactiled.service import Service


@bench.command()
def latency(
    seconds: Annotated[float, typer.Option(help="How long to measure.", min=1)] = 20.0,
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=1, max=1000)] = 100.0,
) -> None:
    """Time a 32 x 32 array from its last CAN message to a WebSocket client on loopback."""
    config = demo_config()
    with threadpool_limits(1):
        service = Service(config)
        (sensor,) = service.sensors.values()
        told = measure(service, config, simulated(config, sensor, "tour").messages, rate_hz, seconds)
    Console().print(_table(told, rate_hz))


def _table(told: Latency, rate_hz: float) -> Table:
    table = Table(title=f"Last CAN message to WebSocket client, 32 x 32 at {rate_hz:g} Hz", caption=describe())
    for name in ("figure", "measured", "aim"):
        table.add_column(name)
    table.add_row("median", f"{told.median:.2f} ms", "under 2 ms")
    table.add_row("99th percentile", f"{told.p99:.2f} ms", "under 10 ms")
    table.add_row("worst", f"{told.worst:.2f} ms", "")
    table.add_row("frames sent / received", f"{told.sent} / {told.received}", "equal")
    table.add_row("simulator, service and server", f"{told.cores:.2f} cores", "under 0.5")
    return table
