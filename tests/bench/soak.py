"""A service that runs for long while clients come and go: whether memory, threads or descriptors grow."""

import asyncio
import json
import random
import threading
import time
from contextlib import suppress
from typing import Annotated, NamedTuple

import httpx
import numpy as np
import typer
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from tactiled.bench.results import host_meter
from tactiled.cli.bench import print_table
from tests.bench import loopback
from tests.bench.sensors import SENSOR

WARM_UP_PART, MAX_WARM_UP_S = 0.25, 900.0  # of the time: caches, pools, windows of the health monitors fill
RELOAD_S = 30.0  # between two reloads, which add a sensor or remove it
RELOAD = "/api/v1/config/reload"
VISITS_AT_ONCE = 4
SAMPLE_S = 1.0


class Sample(NamedTuple):
    """The process at one moment."""

    time: float  # s
    memory_mb: float  # anonymous, resident
    threads: int
    descriptors: int


async def visit(url, client, rng, outcomes):
    """Do what one client may do, and leave in one way or another."""
    name = f"/api/v1/sensors/s{rng.randrange(8)}"
    kind = rng.choice(("stream", "streams", "cut", "slow", "frames", "picture", "past", "events", "metrics"))
    streams = {
        "stream": f"{name}/stream?contacts=1",
        "streams": "/api/v1/stream?flow=newest",
        "cut": f"{name}/stream",
        "slow": f"{name}/stream?format=json",
    }
    requests = {
        "frames": f"{name}/frames/raw?format=npy",
        "picture": f"{name}/frames/restored?format=png",
        "past": f"{name}/frames?kind=raw&last=2s&format=npz",
        "events": "/api/v1/events?wait=2&after=1000000000",
        "metrics": "/metrics",
    }
    try:
        if kind in requests:
            outcomes.append(f"{kind} {(await client.get(requests[kind])).status_code}")
            return
        async with connect(url.replace("http", "ws", 1) + streams[kind], compression=None) as stream:
            if kind == "slow":
                stream.transport.pause_reading()
                await asyncio.sleep(rng.uniform(1, 5))
                stream.transport.resume_reading()
            for _ in range(rng.randrange(2, 40)):
                await asyncio.wait_for(stream.recv(), 5)
            if kind == "cut":
                stream.transport.abort()
        outcomes.append(kind)
    except (OSError, WebSocketException, httpx.HTTPError) as error:
        outcomes.append(f"{kind} {type(error).__name__}")


async def visitors(url, outcomes):
    """Have clients come and go, some at once."""
    rng = random.Random(1)
    async with httpx.AsyncClient(base_url=url, timeout=30) as client:

        async def one_after_another():
            while True:
                await visit(url, client, rng, outcomes)
                await asyncio.sleep(rng.expovariate(2))

        await asyncio.gather(*(one_after_another() for _ in range(VISITS_AT_ONCE)))


async def reloads(url, config, base, outcomes):
    """Add a sensor to a file's text and remove it, again and again."""
    other = SENSOR.format(number="_more", bus=0, id=0x700, side=16)
    async with httpx.AsyncClient(base_url=url, timeout=None) as client:
        while True:
            for text in (base + other, base):
                await asyncio.sleep(RELOAD_S)
                config.write_text(text)
                outcomes.append(f"reload {(await client.post(RELOAD)).status_code}")


async def look(service, samples, seconds):
    """Sample the process for so long."""
    end = time.time() + seconds
    while (now := time.time()) < end:
        memory = service.status("RssAnon") / 1024
        samples.append(Sample(now, memory, service.status("Threads"), service.descriptors()))
        await asyncio.sleep(SAMPLE_S)


async def run(service, config, seconds):
    """Run clients for so long; gives samples and what came of the visits."""
    samples, outcomes, base = [], [], config.read_text()
    jobs = visitors(service.url, outcomes), reloads(service.url, config, base, outcomes)
    tasks = [asyncio.create_task(each) for each in jobs]
    await look(service, samples, seconds)
    for task in tasks:
        if task.done():
            task.result()
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    config.write_text(base)
    httpx.post(service.url + RELOAD, timeout=None).raise_for_status()
    await asyncio.sleep(5)  # the service notices who has left
    await look(service, samples, 3)
    return samples, outcomes


def slope(samples):
    """Memory over time, MB/h, and its standard error from tenths of the time, each at its least."""
    tenths = np.array_split(np.array([(each.time / 3600, each.memory_mb) for each in samples]), 10)
    hours, memory = np.array([(tenth[:, 0].mean(), tenth[:, 1].min()) for tenth in tenths]).T
    (gain, _), covariance = np.polyfit(hours - hours[0], memory, 1, cov=True)
    return float(gain), float(np.sqrt(covariance[0, 0]))


def report(samples, outcomes, warm_up_s):
    """Print what grew after the warm-up, and what did not."""
    warm = samples[0].time + warm_up_s
    steady = [each for each in samples if each.time >= warm]
    gain, error = slope(steady)
    typer.echo(f"memory slope after warm-up: {gain:+.2f} ± {error:.2f} MB/h")
    tenths = ", ".join(f"{part.min():.1f}" for part in np.array_split([each.memory_mb for each in samples], 10))
    typer.echo(f"lowest memory in each tenth of all the time, MB: {tenths}")
    part = (steady[-1].time - warm) / 5
    rows = []
    for title, begin in (("after warm-up", warm), ("at the end", steady[-1].time - part)):
        own = [each for each in steady if begin <= each.time <= begin + part]
        lowest = [min(values) for values in list(zip(*own, strict=True))[1:]]
        rows.append((title, *(f"{value:.1f}" for value in lowest)))
    print_table("soak", ("", "least memory, MB", "least threads", "least descriptors"), rows)
    last = samples[-1]
    typer.echo(f"without clients: {last.memory_mb:.1f} MB, {last.threads} threads, {last.descriptors} descriptors")
    kinds = {kind: outcomes.count(kind) for kind in sorted(set(outcomes))}
    typer.echo(json.dumps(kinds))


def soak(
    hours: Annotated[float, typer.Option(help="How long.", min=0.01)] = 1.0,
    sensors: Annotated[int, typer.Option(help="Arrays of 32 x 32.", min=1, max=100)] = 8,
    rate_hz: Annotated[float, typer.Option(help="Frames a second of each.", min=1)] = 100.0,
) -> None:
    """Run a service while clients come and go and its configuration is reloaded, and print what grows."""
    host = host_meter()
    with loopback.sending(sensors, rate_hz) as config:
        service = loopback.run(config)
        threading.Thread(target=service.process.stdout.read, daemon=True).start()  # a full pipe would stop its log
        try:
            samples, outcomes = asyncio.run(run(service, config, hours * 3600))
        finally:
            with suppress(ProcessLookupError):
                code = service.end()
    typer.echo(f"{loopback.heading(sensors, rate_hz)} for {hours:g} h{host()}")
    report(samples, outcomes, min(WARM_UP_PART * hours * 3600, MAX_WARM_UP_S))
    typer.echo(f"exit code {code}")
