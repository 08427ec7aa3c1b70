"""How long after kill -9 and a new start the first restored frames come, kernels in the cache."""

import asyncio
import time
from typing import Annotated

import typer
from websockets.asyncio.client import connect

from tactiled.wire import unpack
from tests.bench import loopback

RATE_HZ = 100.0


async def first_images(url, sensors):
    """Wait for a restored image of every sensor; gives the times (s) of the first and of the last."""
    names, times = set(), []
    async with connect(url.replace("http", "ws", 1) + "/api/v1/stream?kinds=restored", compression=None) as client:
        while len(names) < sensors:
            data = await client.recv()
            if isinstance(data, bytes) and (name := unpack(data).sensor) not in names:
                names.add(name)
                times.append(time.monotonic())
    return times[0], times[-1]


def restart(
    sensors: Annotated[int, typer.Option(help="Arrays of 32 x 32.", min=1, max=100)] = 1,
    times: Annotated[int, typer.Option(help="Starts.", min=2)] = 5,
    rate_hz: Annotated[float, typer.Option(help="Frames a second of each.", min=1)] = RATE_HZ,
) -> None:
    """Kill a service and start it again, and print when the first restored image reaches a client."""
    with loopback.sending(sensors, rate_hz) as config:
        config.write_text(config.read_text().replace('kernel = { model = "layered" }\n', ""))  # finite elements
        waits = []
        for _ in range(times + 1):  # the first fills the cache
            began = time.monotonic()
            service = loopback.run(config)
            waits.append([at - began for at in asyncio.run(first_images(service.url, sensors))])
            service.kill()
    typer.echo(f"{loopback.heading(sensors, rate_hz)}, s after the start:")
    for number, title in enumerate(("first image", "an image of every sensor")):
        typer.echo(f"  {title}: {', '.join(f'{each[number]:.2f}' for each in waits[1:])}")
