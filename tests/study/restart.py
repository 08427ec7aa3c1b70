"""How long after kill -9 and a new start the first restored frames come, kernels in the cache."""

import asyncio
import socket
import tempfile
import threading
import time
from pathlib import Path
from typing import Annotated

import typer
from websockets.asyncio.client import connect

from tactiled.study.results import machine
from tactiled.wire import unpack
from tests.attack.bystander import queued_s
from tests.process import Running
from tests.study.sensors import SENSOR
from tests.study.soak import BUS, GROUP, SERVER, SIDE, send

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
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("", 0))
        port, config, stop = one.getsockname()[1], Path(folder) / "restart.toml", threading.Event()
        one.close()
        tables = [SENSOR.format(number=n, bus=0, id=0x100 + 4 * n, side=SIDE) for n in range(sensors)]
        tables = [each.replace('kernel = { model = "layered" }\n', "") for each in tables]  # finite elements
        config.write_text(SERVER.format(folder=folder) + BUS.format(group=GROUP, port=port) + "".join(tables))
        sender = threading.Thread(target=send, args=(port, sensors, rate_hz, stop), daemon=True)
        sender.start()
        waits = []
        for _ in range(times + 1):  # the first fills the cache
            began = time.monotonic()
            service = Running(config)
            listening = time.monotonic()
            first, last = asyncio.run(first_images(service.url, sensors))
            queued = queued_s(service.process.pid).get(str(service.process.pid), 0.0)
            service.kill()
            waits.append([*(at - began for at in (listening, first, last)), last - began - queued])
        stop.set()
        sender.join()
    typer.echo(f"{machine()}; {sensors} of {SIDE} x {SIDE} at {rate_hz:g} Hz, s after the start:")
    titles = "it listens", "first image", "an image of every sensor", "the same, less its wait for a busy core"
    for number, title in enumerate(titles):
        typer.echo(f"  {title}: {', '.join(f'{each[number]:.2f}' for each in waits[1:])}")
