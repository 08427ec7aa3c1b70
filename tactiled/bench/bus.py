"""How many CAN messages a second become frames: from memory, and over a bus."""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Codec
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.reader import Reader, open_bus
from tactiled.bus.router import Router
from tactiled.errors import BusError
from tactiled.frames import Message

SKINS: dict[str, Codec] = {
    "packed, 32 x 32 of 12 bits, classic": Packed(1024, 12),
    "packed, 32 x 32 of 12 bits, CAN FD": Packed(1024, 12, fd=True),
    "iCub, 16 triangles": Icub(0, tuple(range(16))),
}
LIVE = "packed, 32 x 32 of 12 bits, classic"
QUIET_S = 1.0  # a bus with nothing on it for so long has said everything
OPEN_S = 30.0  # for the sender to open its end
TICK_S = 0.002  # a sender wakes up so often


@dataclass(frozen=True, slots=True)
class Offline:
    """Messages a second on one core, from memory."""

    skin: str
    segments: int  # messages a frame
    received: float  # decoded and assembled into frames
    encoded: float


@dataclass(frozen=True, slots=True)
class Live:
    """What a reader took from a bus."""

    label: str
    sent: int  # messages
    received: int
    lost: int  # as the frames' own counters have it
    rate: float  # messages a second that came in
    cores: float  # busy with it, with the sender where it is a thread of this process


def offline(seconds: float) -> Iterator[Offline]:
    """Every skin's rates; each is measured for `seconds`."""
    for name, codec in SKINS.items():
        counts, messages = _traffic(codec)
        received = _rate(partial(_push, Router({"it": codec}), messages), seconds)
        encoded = _rate(partial(codec.encode, counts, 0, 0.0), seconds)
        yield Offline(name, codec.segments, received * len(messages), encoded * codec.segments)


def _push(router: Router, messages: list[Message]) -> None:
    for message in messages:
        router.push(message)


def _traffic(codec: Codec) -> tuple[NDArray[np.uint16], list[Message]]:
    """A frame's counts, and the messages of as many frames as a sequence number tells apart."""
    counts = np.random.default_rng(0).integers(0, 256, codec.size).astype(np.uint16)
    return counts, [each for sequence in range(256) for each in codec.encode(counts, sequence, 0.0)]


def _rate(work: Callable[[], object], seconds: float) -> float:
    """Calls a second of processor time, which is what one core does when it has nothing else to do."""
    done, began = 0, time.thread_time()
    while (took := time.thread_time() - began) < seconds or not done:
        work()
        done += 1
    return done / took


def live(settings: dict[str, Any], rate: float, seconds: float) -> Live:
    """Read what a sender puts on a bus at `rate` messages a second; a virtual bus has its sender in a thread."""
    reader = open_bus(**settings)
    codec, count = SKINS[LIVE], round(rate * seconds)
    task = (settings, rate, count)
    alone = settings["interface"] != "virtual"
    make = multiprocessing.get_context("spawn").Process if alone else Thread
    sender = make(target=send, args=task, daemon=True)
    sender.start()
    router = Router({"it": codec})
    try:
        received, took, busy = _drain(reader, router)
    finally:
        reader.close()
        sender.join()
    return Live(reader.label, count, received, router.assemblers["it"].loss.lost, received / took, busy / took)


def _drain(reader: Reader, router: Router) -> tuple[int, float, float]:
    """Take messages until the bus is quiet: how many, in what time (s), busy for how long (s of CPU)."""
    message = reader.receive(OPEN_S)
    if message is None:
        raise BusError(
            f"bus {reader.label}: nothing came in within {OPEN_S:g} s: can its interface send to itself?"
        )
    began, busy = time.perf_counter(), time.process_time()
    received, last, spent = 0, began, 0.0
    while message is not None:
        router.push(message)
        received += 1
        if received % 64 == 0:
            last, spent = time.perf_counter(), time.process_time() - busy
        message = reader.receive(QUIET_S)
    return received, max(last - began, TICK_S), spent


def send(settings: dict[str, Any], rate: float, count: int) -> None:
    """Put `count` messages on a bus, paced in blocks."""
    bus = open_bus(**settings)
    _, messages = _traffic(SKINS[LIVE])
    source, block = islice(cycle(messages), count), max(1, round(rate * TICK_S))
    due = time.perf_counter()
    while batch := list(islice(source, block)):
        time.sleep(max(0.0, due - time.perf_counter()))
        for message in batch:
            bus.send(message)
        due += len(batch) / rate
    bus.close()
