"""How many CAN messages a second become frames: from memory, and over a bus."""

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from threading import Thread
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Codec
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.reader import Reader, open_bus
from tactiled.bus.router import Router
from tactiled.errors import BusError
from tactiled.frames import Message
from tactiled.study.blast import Blast

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
    """What readers took from their buses."""

    label: str
    sent: int  # messages
    received: int
    lost: int  # as the frames' own counters have it
    rate: float  # messages a second that came in
    cores: float | None  # busy with reading and assembling; None where the kernel's clock is too coarse to tell


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


def live(buses: Sequence[dict[str, Any]], rate: float, seconds: float) -> Live:
    """Read what a sender puts on buses, `rate` messages a second over all of them; each has a thread, as in `run`.

    The sender is another process; a virtual bus, which no other process sees, has it in a thread.
    """
    readers = [open_bus(**each) for each in buses]
    count = round(rate * seconds / len(buses))
    alone = all(each["interface"] != "virtual" for each in buses)
    make = multiprocessing.get_context("spawn").Process if alone else Thread
    sender = make(target=send, args=(buses, rate / len(buses), count), daemon=True)
    sender.start()
    try:
        with ThreadPoolExecutor(len(readers)) as pool:
            taken = list(pool.map(_drain, readers))
    finally:
        for reader in readers:
            reader.close()
        sender.join()
    return Live(
        " and ".join(each.label for each in readers),
        count * len(buses),
        sum(each.received for each in taken),
        sum(each.lost for each in taken),
        sum(each.received / each.took for each in taken),
        sum(each.busy / each.took for each in taken) if _tick() < TICK_S else None,
    )


def _tick() -> float:
    """The step (s) in which the kernel counts a thread's processor time: 10 ms in the test kernel."""
    now = began = time.thread_time()
    while now == began:
        now = time.thread_time()
    return now - began


class Taken(NamedTuple):
    """What came of one bus."""

    received: int  # messages
    lost: int
    took: float  # s
    busy: float  # s of processor time


def _drain(reader: Reader) -> Taken:
    """Take messages and make frames of them until the bus is quiet."""
    router = Router({"it": SKINS[LIVE]})
    if not (messages := reader.batch(OPEN_S)):
        raise BusError(
            f"bus {reader.label}: nothing came in within {OPEN_S:g} s: can its interface send to itself?"
        )
    began, busy = time.perf_counter(), time.thread_time()
    received, last, spent = 0, began, 0.0
    while messages:
        for message in messages:
            router.push(message)
        received += len(messages)
        last, spent = time.perf_counter(), time.thread_time() - busy
        messages = reader.batch(QUIET_S)
    return Taken(received, router.assemblers["it"].loss.lost, max(last - began, TICK_S), spent)


def send(buses: Sequence[dict[str, Any]], rate: float, count: int) -> None:
    """Put `count` messages on each of some buses, `rate` a second on each, paced in blocks."""
    _, messages = _traffic(SKINS[LIVE])
    block = max(1, round(rate * TICK_S))
    with ExitStack() as stack:
        senders = [_sender(each, messages, stack) for each in buses]
        due = time.perf_counter()
        for left in range(count, 0, -block):
            time.sleep(max(0.0, due - time.perf_counter()))
            for put in senders:
                put(min(block, left))
            due += block / rate


def _sender(settings: dict[str, Any], messages: list[Message], stack: ExitStack) -> Callable[[int], None]:
    """What sends the next so many of `messages`, over and over."""
    if settings["interface"] == "socketcan":
        return stack.enter_context(Blast(settings["channel"], messages)).send
    bus, source = open_bus(**settings), cycle(messages)
    stack.callback(bus.close)

    def put(count: int) -> None:
        for message in islice(source, count):
            bus.send(message)

    return put
