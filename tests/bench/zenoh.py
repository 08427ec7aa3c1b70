"""What a Zenoh network costs between a reader and a server: rates, cores, and the time on the way."""

import multiprocessing
import time
from dataclasses import replace
from typing import Annotated

import numpy as np
import typer

from tactiled.config import Server, Zenoh, parse
from tactiled.frames import Loss, RawFrame
from tactiled.interop.zenoh.fleet import Fleet
from tactiled.interop.zenoh.publisher import ReaderPublisher
from tactiled.interop.zenoh.session import Answer
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.web import answers
from tests.conftest import CONFIG
from tests.process import free_port

RATE_HZ, SIDE = 100.0, 32
CASES = (1, 4, 16, 64)  # sensors
HEAD = ("Sensors", "frames/s made", "shown", "lost", "cores of the reader", "of the server", "p50 ms", "p99 ms")
ROUTER = '{{mode: "router", listen: {{endpoints: ["{}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'


def read(endpoint, count, seconds, out):
    """Publish images of `count` arrays, without buses and restoration; puts cores and frames a second."""
    text = CONFIG.replace("rows = 8, columns = 8", f"rows = {SIDE}, columns = {SIDE}")
    service = Service(parse(text.format(channel="r0")))
    plan, size = service.sensors["palm"].plan, SIDE**2
    frame = RawFrame(0, 0.0, 0.0, np.full(size, 200, np.uint16), np.zeros(size, np.uint8), Loss())
    image = service.sensors["palm"].pipeline.process(frame)
    service.sensors = {name: Sensor(replace(plan, name=name)) for name in (f"s{n}" for n in range(count))}
    geometry = answers.geometry(service.sensors["s0"]).model_dump_json().encode()

    def describe(sensor):
        return answers.sensor_state(sensor).model_dump(mode="json")

    settings = Zenoh(mode="client", connect=[endpoint], robot="r0")
    with ReaderPublisher(service, settings, describe, lambda _: Answer(200, {}, geometry)).running():
        time.sleep(5)  # until a server knows the sensors
        cpu, start, frames = time.process_time(), time.monotonic(), 0
        while time.monotonic() < start + seconds:
            frames += 1
            for sensor in service.sensors.values():
                sensor.hub.publish(replace(image, sequence=frames, time=time.time()))
            time.sleep(max(0.0, start + frames / RATE_HZ - time.monotonic()))
        out.put(((time.process_time() - cpu) / seconds, frames * count / seconds))


def route(endpoint, out):
    """A router until it is killed."""
    import zenoh as network

    session = network.open(network.Config.from_json5(ROUTER.format(endpoint)))
    out.put("open")
    time.sleep(1e6)
    session.close()


def measure(sensors, seconds):
    """One row of HEAD."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    context = multiprocessing.get_context("spawn")
    out, late = context.Queue(), []
    router = context.Process(target=route, args=(endpoint, out), daemon=True)
    router.start()
    out.get()
    fleet = Fleet(Zenoh(mode="client", connect=[endpoint]), Server())
    with fleet.running():
        reader = context.Process(target=read, args=(endpoint, sensors, seconds, out))
        reader.start()
        while len(fleet.sensors) < sensors:
            time.sleep(0.01)
        for sensor in fleet.sensors.values():
            sensor.hub.subscribe(lambda image: late.append(time.time() - image.time))
        cpu = time.process_time()
        reader_cores, made_hz = out.get()
        cores = (time.process_time() - cpu) / seconds
        time.sleep(0.5)
        lost = sum(each.line.lost for each in fleet.sensors.values())
    reader.join()
    router.kill()
    p50, p99 = np.percentile(late, (50, 99)) * 1e3
    rates = [f"{each:.0f}" for each in (sensors, made_hz, len(late) / seconds, lost)]
    return *rates, *(f"{each:.2f}" for each in (reader_cores, cores, p50, p99))


def zenoh(seconds: Annotated[float, typer.Option(help="Of each row.")] = 8.0) -> None:
    """Time and cores between a reader and a server, over a router on loopback, images of 32 x 32 at 100 Hz."""
    for row in (HEAD, ["---"] * len(HEAD)):
        print(f"| {' | '.join(row)} |")
    for sensors in CASES:
        print(f"| {' | '.join(measure(sensors, seconds))} |", flush=True)
