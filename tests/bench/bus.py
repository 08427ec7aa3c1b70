"""How many CAN messages a second become frames: from memory, and over a bus."""

import multiprocessing
import socket
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import numpy as np

from tactiled.bench.results import machine
from tactiled.bus.batch import Batch
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.reader import open_bus
from tactiled.bus.router import Router
from tactiled.bus.socketcan import MAX_FRAMES
from tactiled.cli.bench import print_table
from tactiled.errors import BusError

LIVE = "packed, 32 x 32 of 12 bits, classic"
SKINS = {
    LIVE: Packed(1024, 12),
    "packed, 32 x 32 of 12 bits, CAN FD": Packed(1024, 12, fd=True),
    "iCub, 16 triangles": Icub(0, tuple(range(16))),
    "XELA, 4 x 6": Xela(),
}
QUIET_S = 5.0  # a bus that is quiet for so long has lost the rest
OPEN_S = 30.0  # for the sender to open its end
TICK_S = 0.002  # a sender wakes up so often
CAN_FRAME = struct.Struct("=IB3x8s")  # of Linux: id, length, data
HEADINGS = ("skin", "messages a frame", "decoded and assembled", "encoded")


def offline(seconds):
    """(skin, messages a frame, messages a second decoded and assembled, encoded); `seconds` each."""
    for name, codec in SKINS.items():
        counts, messages = _traffic(codec)
        router = Router({"it": codec})
        batches = [Batch.of(messages[at : at + MAX_FRAMES]) for at in range(0, len(messages), MAX_FRAMES)]
        received = _calls_per_s(lambda router=router, batches=batches: [*map(router.push, batches)], seconds)
        encoded = _calls_per_s(partial(codec.encode, counts, 0, 0.0), seconds)
        yield name, codec.segments, received * len(messages), encoded * codec.segments


def _traffic(codec):
    """A frame's counts, and the messages of as many frames as a sequence number distinguishes."""
    counts = np.random.default_rng(0).integers(0, 256, codec.size).astype(np.uint16)
    return counts, [each for sequence in range(256) for each in codec.encode(counts, sequence, 0.0)]


def _calls_per_s(work, seconds):
    """Calls a second of processor time: those of one core that does nothing else."""
    done, began = 0, time.thread_time()
    while (took := time.thread_time() - began) < seconds or not done:
        work()
        done += 1
    return done / took


class Live(NamedTuple):
    """Result of one or several buses."""

    messages: int  # sent
    received: int
    lost: int  # by the frames' own counters
    rate: float  # messages a second that came in
    cores: float  # busy with reading and assembling, by the kernel's clock


def live(buses, rate, seconds):
    """Read what a sender puts on buses, `rate` messages a second over all of them; each has a thread, as in `run`.

    The sender is another process; on a virtual bus, which no other process sees, a thread.
    """
    readers = [open_bus(**each) for each in buses]
    count = round(rate * seconds / len(buses))
    alone = all(each["interface"] != "virtual" for each in buses)
    make = multiprocessing.get_context("spawn").Process if alone else Thread
    sender = make(target=send, args=(buses, rate / len(buses), count), daemon=True)
    sender.start()
    try:
        with ThreadPoolExecutor(len(readers)) as pool:
            results = list(pool.map(partial(_drain, count), readers))
    finally:
        for reader in readers:
            reader.close()
        sender.join()
    received, lost, rates, cores = map(sum, zip(*results, strict=True))
    return Live(count * len(buses), received, lost, rates, cores)


def _drain(count, reader):
    """Make frames of `count` messages, or until the bus is quiet: received, lost, messages a second, cores."""
    router = Router({"it": SKINS[LIVE]})
    if not len(messages := reader.batch(OPEN_S)):
        raise BusError(f"bus {reader.label}: no message within {OPEN_S:g} s: can its interface send to itself?")
    began, busy = time.perf_counter(), time.thread_time()
    received, last, cores_s = 0, began, 0.0
    while len(messages):
        router.push(messages)
        received += len(messages)
        last, cores_s = time.perf_counter(), time.thread_time() - busy
        messages = reader.batch(QUIET_S, router.needed) if received < count else ()
    took = max(last - began, TICK_S)
    return received, router.assemblers["it"].loss.lost, received / took, cores_s / took


def send(buses, rate, count):
    """Put `count` messages on each of some buses, `rate` a second on each, paced in blocks."""
    _, messages = _traffic(SKINS[LIVE])
    block = max(1, round(rate * TICK_S))
    with ExitStack() as stack:
        senders = [(_sender(each, stack), cycle(messages)) for each in buses]
        due = time.perf_counter()
        for remaining in range(count, 0, -block):
            time.sleep(max(0.0, due - time.perf_counter()))
            for put, source in senders:
                for each in islice(source, min(block, remaining)):
                    put(each)
            due += block / rate


def _sender(bus, stack):
    """Sends one message: on SocketCAN by a bare socket, so that the reader is what is measured."""
    if bus["interface"] != "socketcan":
        opened = open_bus(**bus)
        stack.callback(opened.close)
        return opened.send
    can = stack.enter_context(socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW))
    can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")  # it receives nothing
    can.bind((bus["channel"],))
    return lambda each: can.send(CAN_FRAME.pack(each.id, len(each.data), each.data))


def buses_of(interface, channels):
    """The buses of each live measurement: a virtual one and any vcan, unless one is named."""
    if interface:
        return [[{"interface": interface, "channel": name} for name in channels]]
    vcans = [name for name in ("vcan0", "vcan1") if Path("/sys/class/net", name).exists()]
    measured = [[{"interface": "virtual", "channel": "tactiled-bench"}]]
    return measured + ([[{"interface": "socketcan", "channel": name} for name in vcans]] if vcans else [])


def bus(interface: str = "", channel: list[str] = [], rate: float = 16_000, seconds: float = 2.0) -> None:  # noqa: B006
    """Count the messages a second that are decoded and assembled, from memory and over a bus."""
    rows = [
        (name, str(each), f"{received:,.0f}", f"{encoded:,.0f}")
        for name, each, received, encoded in offline(seconds)
    ]
    print_table("CAN messages a second, one core, from memory (aim: 200,000 decoded)", HEADINGS, rows)
    for buses in buses_of(interface, channel):
        result = live(buses, rate, seconds)
        print(
            f"{buses[0]['interface']} {', '.join(each['channel'] for each in buses)}: {result.messages:,} messages"
            f" sent at {rate:,.0f}/s, {result.received:,} received at {result.rate:,.0f}/s, {result.lost:,} lost;"
            f" cores busy reading: {result.cores:.2f} (aim: 16,000/s, none lost, under 0.6)"
        )
    print(machine())
