"""How many sensors a core carries, and how old their images are: whole services on buses that exist in memory."""

import pickle
import time
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from unittest import mock

import numpy as np

from tactiled.bench.results import machine
from tactiled.bus.batch import Batch
from tactiled.bus.router import Router
from tactiled.cli.bench import print_table
from tactiled.config import parse
from tactiled.frames import Message
from tactiled.live.service import Service
from tactiled.simulate.playback import SCENE_S, TOUR, player
from tests.bench.checkout import figures

RATE_HZ = 100.0
SCENE_FRAMES = (
    128  # of every scene of the tour, as it moves from its middle on; 6 of them wrap the sequence number
)
SENSORS_PER_BUS = 4  # more of 32 x 32 do not fit on one bus of CAN FD
WARM_UP_S = 1.5  # the noise is measured
DRAIN_S = 0.3
SLOW_SIDE = 64
BUS = '[bus.b{bus}]\ninterface = "virtual"\nchannel = "{bus}"\n'
SENSOR = """
[sensor.s{number}]
bus = "b{bus}"
codec = {{ name = "packed", fd = true, base_id = {id} }}
array = {{ rows = {side}, columns = {side}, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 1.0, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.05, no_load = 100 }}
"""
HEADINGS = ("sensors", "µs/frame", "a core carries", "cores", "p50 ms", "p99 ms", "not restored")


class Live(NamedTuple):
    """A service in real time."""

    cores: float
    ages_ms: dict[int, np.ndarray]  # by side: from when the last message is due to the image
    missed: float  # part of the frames that newer ones replaced


def configuration(sides):
    """That of arrays of `sides` squared."""
    buses = [n // SENSORS_PER_BUS for n in range(len(sides))]
    tables = [SENSOR.format(number=n, bus=buses[n], id=0x100 + 4 * n, side=side) for n, side in enumerate(sides)]
    return "".join(BUS.format(bus=each) for each in sorted({*buses})) + "".join(tables)


def make_service(sides):
    """A service of arrays of `sides` squared."""
    return Service(parse(configuration(sides)))


@cache
def recorded(side):
    """Payloads of every message of every frame of the tour."""
    plan = make_service([side]).sensor("s0").plan
    source = player(plan.array, plan.kernel, plan.codec, plan.calibration, noise_kpa=0.2)
    times = [SCENE_S * (n + 0.25) + k / RATE_HZ for n in range(len(TOUR)) for k in range(SCENE_FRAMES)]
    return [[each.data for each in source.messages(n, t, 0.0)] for n, t in enumerate(times)]


class Feed:
    """What some sensors send, in a reader's place: each starts with another scene, one after the other is due."""

    off, unsent, kinds, clock = None, 0, {}, "study"

    began = 0.0  # s, of all feeds

    def __init__(self, sensors):
        self._sensors = [(int(each.name[1:]), recorded(each.array.shape[0]), each.codec.id) for each in sensors]
        self.position = 0

    def next(self):
        """When the next frame is due, s, and its messages."""
        number, place = divmod(self.position, len(self._sensors))
        first, frames, id_ = self._sensors[place]
        due = self.began + (number + place / len(self._sensors)) / RATE_HZ
        return due, [
            Message(due, id_, each, fd=True) for each in frames[(number + SCENE_FRAMES * first) % len(frames)]
        ]

    def batch(self, timeout, needed):
        del needed  # a frame at a time
        due, messages = self.next()
        if (wait := due - time.time()) > 0:
            time.sleep(min(wait, timeout))
            return Batch.of(())
        self.position += 1
        return Batch.of(messages)

    def send(self, message):
        raise AssertionError(f"these sensors need no message: {message}")

    def counts(self):
        return {}

    def close(self):
        pass


def frame_us(sides, rounds=5):
    """Processor time of a frame from messages to history, µs: all sensors in turn, the least of some rounds."""
    service = make_service(sides)
    sensors = list(service.sensors.values())
    feed, router = Feed(sensors), Router({each.name: each.codec for each in sensors})
    count = max(len(sides), len(TOUR) * SCENE_FRAMES // len(sides) * len(sides))
    took = []
    for _ in range(rounds + 1):  # the first warms up
        began = time.thread_time()
        for _ in range(count):
            due, messages = feed.next()
            feed.position += 1
            for name, frame in router.push(Batch.of(messages), due):
                service.sensors[name].restore(frame)
        took.append((time.thread_time() - began) / count * 1e6)
    return min(took[1:])


def live(sides, seconds):
    """Run a service in real time, each bus on its own thread."""
    service = make_service(sides)
    sensors = list(service.sensors.values())
    ages = [[] for _ in sides]
    for each, own in zip(sensors, ages, strict=True):
        each.hub.subscribe(lambda image, own=own: own.append((image.time, time.time() - image.time)))
    groups = [sensors[n : n + SENSORS_PER_BUS] for n in range(0, len(sensors), SENSORS_PER_BUS)]
    feeds = {str(n): Feed(each) for n, each in enumerate(groups)}  # by channel
    Feed.began = time.time() + 0.2
    first = Feed.began + WARM_UP_S
    last = first + seconds
    with (
        mock.patch("tactiled.live.bus_thread.open_bus", lambda channel, **_: feeds[channel]),
        service.running(),
    ):
        time.sleep(max(0.0, first - time.time()))
        busy, clock = time.process_time(), time.perf_counter()
        time.sleep(max(0.0, last - time.time()))
        cores = (time.process_time() - busy) / (time.perf_counter() - clock)
        time.sleep(DRAIN_S)
    counted = [[age for due, age in own if first <= due < last] for own in ages]
    by_side = {
        side: np.concatenate([own for own, each in zip(counted, sides, strict=True) if each == side]) * 1e3
        for side in sides
    }
    return Live(cores, by_side, 1 - sum(map(len, counted)) / (seconds * RATE_HZ * len(sides)))


def _row(sides, seconds, rounds):
    side, slow, result = sides[0], sides[-1] != sides[0], live(sides, seconds)
    us = "" if slow else f"{frame_us(sides, rounds):.0f}"
    age = result.ages_ms[side]
    p50, p99 = np.percentile(age, (50, 99)) if len(age) else (np.nan, np.nan)
    return (
        f"{len(sides) - slow} of {side}²{f', one of {SLOW_SIDE}²' if slow else ''}",
        us, f"{1e6 / RATE_HZ / float(us):.0f}" if us else "",
        f"{result.cores:.2f}", f"{p50:.2f}", f"{p99:.2f}", f"{result.missed:.2%}",
    )  # fmt: skip


def sensors(
    side: list[int] = [16, 32],  # noqa: B006
    count: list[int] = [1, 4, 16, 64],  # noqa: B006
    seconds: float = 5.0,
    rounds: int = 5,
) -> None:
    """Count the sensors that a core carries at 100 Hz, and how old their images are in a running service."""
    arrays = [[each] * n for each in side for n in count] + [[each] * 3 + [SLOW_SIDE] for each in side]
    rows = [_row(each, seconds, rounds) for each in arrays]
    print_table(
        f"Sensors at {RATE_HZ:.0f} Hz, a tour of scenes; ages without the slow array's own", HEADINGS, rows
    )
    print(machine())


WORKER = """
import pickle, sys, time
from tactiled.bus.router import Router
from tactiled.config import parse
from tactiled.frames import Message
text, payloads, count, frames = pickle.load(open(sys.argv[1], "rb"))
config = parse(text)
try:
    from tactiled.service import Service  # 0.4.2
except ModuleNotFoundError:
    from tactiled.bus.batch import Batch
    from tactiled.live.service import Service
    sensors = Service(config).sensors
    router = Router({name: each.codec for name, each in sensors.items()})
    def feed(messages, due):
        for name, frame in router.push(Batch.of(messages), due):
            sensors[name].restore(frame)
else:
    sensors = Service(config).sensors
    router = Router({name: each.plan.codec for name, each in sensors.items()})
    def feed(messages, due):
        for each in messages:
            for name, frame in router.push(each):
                sensors[name].show(frame)
began, took, n = time.time(), [], 0
for _ in range(6):
    start = time.thread_time()
    for _ in range(frames):
        number, place = divmod(n, count)
        due, n = began + (number + place / count) / 100, n + 1
        data = payloads[(number + len(payloads) // 6 * place) % len(payloads)]
        feed([Message(due, 0x100 + 4 * place, each, fd=True) for each in data], due)
    took.append((time.thread_time() - start) / frames)
print(1e6 * min(took[1:]))
"""


def sensors_against(tree: Path, rounds: int = 2) -> None:
    """Compare the sensors that a core carries at 100 Hz with a checkout, in turn: 0.4.2 or later."""
    rows = []
    for side, count in ((16, 1), (16, 16), (32, 1), (32, 16)):
        took: dict[Path, list[float]] = {tree: [], Path.cwd(): []}
        frames = len(TOUR) * SCENE_FRAMES
        with TemporaryDirectory() as folder:
            path = Path(folder) / "frames.pickle"
            payloads = [[bytes(each) for each in frame] for frame in recorded(side)]
            path.write_bytes(pickle.dumps((configuration([side] * count), payloads, count, frames)))
            for checkout in list(took) * rounds:
                took[checkout] += figures(checkout, WORKER, str(path))
        for checkout, us in took.items():
            rows.append((f"{count} of {side}²", str(checkout), f"{min(us):.0f}", f"{1e6 / RATE_HZ / min(us):.0f}"))
    print_table("One frame, from its messages to the history", ("", "checkout", "µs", "a core carries"), rows)
    print(machine())
