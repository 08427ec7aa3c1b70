"""How many CAN messages a second become frames: from memory, and over a bus."""

import time
from contextlib import closing
from functools import partial
from itertools import cycle, islice
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

LIVE = "packed, 32 x 32 of 12 bits, classic"
SKINS = {
    LIVE: Packed(1024, 12),
    "packed, 32 x 32 of 12 bits, CAN FD": Packed(1024, 12, fd=True),
    "iCub, 16 triangles": Icub(0, tuple(range(16))),
    "XELA, 4 x 6": Xela(),
}
QUIET_S = 5.0  # a bus that is quiet for so long has lost the rest
TICK_S = 0.002  # a sender wakes up so often
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
    """What came over a bus."""

    received: int  # messages
    lost: int  # by the frames' own counters
    rate: float  # messages a second that came in
    cores: float  # busy with reading and assembling, by the kernel's clock


def live(channel, count, rate):
    """Make frames of `count` messages of a virtual bus, on which a thread puts `rate` a second."""
    router, settings = Router({"it": SKINS[LIVE]}), {"interface": "virtual", "channel": channel}
    with closing(open_bus(**settings)) as reader, closing(open_bus(**settings)) as sender:
        thread = Thread(target=send, args=(sender, rate, count))
        thread.start()
        messages = reader.batch(QUIET_S)
        began, busy = time.perf_counter(), time.thread_time()
        received, last, cores_s = 0, began, 0.0
        while len(messages):
            router.push(messages)
            received += len(messages)
            last, cores_s = time.perf_counter(), time.thread_time() - busy
            messages = reader.batch(QUIET_S, router.needed) if received < count else ()
        thread.join()
    took = max(last - began, TICK_S)
    return Live(received, router.assemblers["it"].loss.lost, received / took, cores_s / took)


def send(bus, rate, count):
    """Put `count` messages on a bus, `rate` a second, paced in blocks."""
    _, messages = _traffic(SKINS[LIVE])
    block, source, due = max(1, round(rate * TICK_S)), cycle(messages), time.perf_counter()
    for remaining in range(count, 0, -block):
        time.sleep(max(0.0, due - time.perf_counter()))
        for each in islice(source, min(block, remaining)):
            bus.send(each)
        due += block / rate


def bus(rate: float = 16_000, seconds: float = 2.0) -> None:
    """Count the messages a second that are decoded and assembled, from memory and over a virtual bus."""
    rows = [
        (name, str(each), f"{received:,.0f}", f"{encoded:,.0f}")
        for name, each, received, encoded in offline(seconds)
    ]
    print_table("CAN messages a second, one core, from memory (aim: 200,000 decoded)", HEADINGS, rows)
    sent = round(rate * seconds)
    result = live("tactiled-bench", sent, rate)
    print(
        f"virtual: {sent:,} messages sent at {rate:,.0f}/s, {result.received:,} received at {result.rate:,.0f}/s,"
        f" {result.lost:,} lost; cores busy reading: {result.cores:.2f} (aim: 16,000/s, none lost, under 0.6)"
    )
    print(machine())
