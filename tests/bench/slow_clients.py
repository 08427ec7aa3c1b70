"""How old images are in programs that take longer for each than a sensor sends: what their libraries queue."""

import asyncio
import shutil
import time
from statistics import median
from typing import Annotated

import typer
from playwright.sync_api import sync_playwright
from websocket import create_connection
from websockets.asyncio.client import connect as connect_async
from websockets.sync.client import connect

from tactiled.cli.bench import print_table
from tactiled.wire import unpack
from tests.bench import loopback

RATE_HZ, SLOW_S = 20.0, 0.25
BEGIN = 8  # images, in which a library fills its queue
NEXT = '{"type": "next"}'
PAGE = """async ([url, slow, images, next, kinds]) => {
  const ages = [], socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => next && socket.send(next);
  await new Promise(done => {
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") return;
      ages.push(Date.now() / 1000 - new DataView(data).getFloat64(24, true));
      for (const end = Date.now() + 1000 * slow; Date.now() < end;);
      if (next && ages.length % kinds === 0) socket.send(next);
      if (ages.length === images) done();
    };
  });
  return ages;
}"""


def blocking(url, images, credit, connected=connect):
    """Ages (s) of images in a program that blocks, and requests a frame of so many images if `credit`."""
    ages, socket = [], connected(url)
    if credit:
        socket.send(NEXT)
    while len(ages) < images:
        if isinstance(data := socket.recv(), bytes):
            ages.append(time.time() - unpack(data).timestamp)
            time.sleep(SLOW_S)
            if credit and len(ages) % credit == 0:
                socket.send(NEXT)
    socket.close()
    return ages


async def awaiting(url, images, credit):
    """The same in one that awaits."""
    ages = []
    async with connect_async(url, compression=None) as socket:
        if credit:
            await socket.send(NEXT)
        while len(ages) < images:
            if isinstance(data := await socket.recv(), bytes):
                ages.append(time.time() - unpack(data).timestamp)
                await asyncio.sleep(SLOW_S)
                if credit and len(ages) % credit == 0:
                    await socket.send(NEXT)
    return ages


def browser(url, images, credit):
    """The same in a page of Chromium."""
    with sync_playwright() as playwright:
        path = shutil.which("chromium-headless-shell") or shutil.which("chromium")
        page = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"]).new_page()
        page.goto(url.replace("ws", "http", 1).split("/api")[0] + "/api/v1/health")
        return page.evaluate(PAGE, [url, SLOW_S, images, NEXT if credit else "", credit])


PROGRAMS = {
    "websocket-client": lambda *each: blocking(*each, create_connection),
    "websockets": blocking,
    "websockets, asyncio": lambda *each: asyncio.run(awaiting(*each)),
    "Chromium": browser,
}


def slow_clients(
    images: Annotated[int, typer.Option(help="For each program.", min=2 * BEGIN)] = 60,
    kinds: Annotated[str, typer.Option(help="Of image, which the program takes one by one.")] = "restored",
) -> None:
    """Measure the age of images in programs that take 0.25 s for each of 20 a second."""
    rows, asks = [], kinds.count(",") + 1
    with loopback.sending(1, RATE_HZ) as config:
        service = loopback.run(config)
        try:
            url = service.url.replace("http", "ws", 1) + f"/api/v1/sensors/s0/stream?kinds={kinds}"
            for name, ages_in in PROGRAMS.items():
                for flow in ("newest", "credit"):
                    ages = ages_in(f"{url}&flow={flow}", images, asks * (flow == "credit"))[BEGIN:]
                    rows.append((name, flow, f"{median(ages):.2f}", f"{max(ages):.2f}"))
        finally:
            service.kill()
    print_table(f"Age of images ({kinds}), s; {SLOW_S} s for each", ("program", "flow", "median", "oldest"), rows)
    typer.echo(loopback.heading(1, RATE_HZ))
