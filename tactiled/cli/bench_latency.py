"""`tactiled bench latency`: how old an image is when a client has it."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.cli.demo import demo_config, simulated
from tactiled.runtime.service import Service
from tactiled.study.latency import Latency, measure
from tactiled.study.machine import describe


def latency(
    seconds: Annotated[float, typer.Option(help="How long to measure.", min=1)] = 20.0,
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=1, max=1000)] = 100.0,
    clients: Annotated[int, typer.Option(help="WebSocket clients.", min=1, max=500)] = 1,
) -> None:
    """Time a 32 x 32 array from its last CAN message to WebSocket clients on loopback."""
    config = demo_config()
    with threadpool_limits(1):
        service = Service(config)
        (sensor,) = service.sensors.values()
        told = measure(service, config, simulated(config, sensor, "tour").messages, rate_hz, seconds, clients)
    Console().print(_table(told, rate_hz, clients))


def _table(told: Latency, rate_hz: float, clients: int) -> Table:
    many = clients > 1
    whom = f"{clients} WebSocket clients" if many else "WebSocket client"
    table = Table(title=f"Last CAN message to {whom}, 32 x 32 at {rate_hz:g} Hz", caption=describe())
    for name in ("figure", "measured", "aim"):
        table.add_column(name)
    table.add_row("median", f"{told.median:.2f} ms", "" if many else "under 2 ms")
    worst = ", of the client whose is worst" if many else ""
    table.add_row(f"99th percentile{worst}", f"{told.p99:.2f} ms", "under 20 ms" if many else "under 10 ms")
    table.add_row("worst", f"{told.worst:.2f} ms", "")
    fewest = ", by the client with fewest" if many else ""
    table.add_row(f"frames sent / received{fewest}", f"{told.sent} / {told.received}", "equal")
    core = ", on one core" if told.pinned else ""
    table.add_row(f"simulator, service and server{core}", f"{told.cores:.2f} cores", "" if many else "under 0.5")
    table.add_row("clients" if many else "client", f"{told.client_cores:.2f} cores", "")
    return table
