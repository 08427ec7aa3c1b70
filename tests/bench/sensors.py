"""How many sensors a core carries: one frame's processor time, against another checkout's."""

import os
import pickle
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from tactiled.bench.results import machine
from tactiled.cli.bench import print_table
from tactiled.config import parse
from tactiled.live.service import Service
from tactiled.simulate.playback import SCENE_S, TOUR, player

RATE_HZ = 100.0
SCENE_FRAMES = 128  # of every scene of the tour, from its middle on; 6 of them wrap the sequence number
SENSORS_PER_BUS = 4  # more of 32 x 32 do not fit on one bus of CAN FD
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


def configuration(side, count):
    """That of so many arrays of `side` squared."""
    tables = [SENSOR.format(number=n, bus=n // SENSORS_PER_BUS, id=0x100 + 4 * n, side=side) for n in range(count)]
    return "".join(BUS.format(bus=n) for n in range(-(-count // SENSORS_PER_BUS))) + "".join(tables)


@cache
def recorded(side):
    """Payloads of every message of every frame of the tour."""
    plan = Service(parse(configuration(side, 1))).sensor("s0").plan
    source = player(plan.array, plan.kernel, plan.codec, plan.calibration, noise_kpa=0.2)
    times = [SCENE_S * (n + 0.25) + k / RATE_HZ for n in range(len(TOUR)) for k in range(SCENE_FRAMES)]
    return [[each.data for each in source.messages(n, t, 0.0)] for n, t in enumerate(times)]


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


def _worked(tree, path):
    """Microseconds of a frame with the package of a checkout, on one thread."""
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-P", "-c", WORKER, str(path)]
    return float(subprocess.check_output(command, env=environment, text=True))


def sensors_against(tree: Path, rounds: int = 2) -> None:
    """Compare the sensors that a core carries at 100 Hz with a checkout, in turn: 0.4.2 or later."""
    rows = []
    for side, count in ((16, 1), (16, 16), (32, 1), (32, 16)):
        took: dict[Path, list[float]] = {tree: [], Path.cwd(): []}
        frames = len(TOUR) * SCENE_FRAMES
        with TemporaryDirectory() as folder:
            path = Path(folder) / "frames.pickle"
            payloads = [[bytes(each) for each in frame] for frame in recorded(side)]
            path.write_bytes(pickle.dumps((configuration(side, count), payloads, count, frames)))
            for checkout in list(took) * rounds:
                took[checkout].append(_worked(checkout, path))
        for checkout, us in took.items():
            rows.append((f"{count} of {side}²", str(checkout), f"{min(us):.0f}", f"{1e6 / RATE_HZ / min(us):.0f}"))
    print_table("One frame, from its messages to the history", ("", "checkout", "µs", "a core carries"), rows)
    print(machine())
