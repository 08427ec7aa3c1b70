"""python -m tests.viewer.measure_seek [MINUTES]: times of seeking in a recording of 32 x 32 taxels at 100 Hz.

Over HTTP from another thread of the same process: raw and restored image of one frame, anywhere, by `auto`.
"""

import sys
import time
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory

import httpx
import numpy as np

from tactiled.config import Server, parse
from tactiled.live.service import Service
from tactiled.simulate import player
from tactiled.web.server import running
from tests.conftest import HTTP
from tests.viewer.measure import BUS, SENSOR

RATE_HZ, SEEKS, PAUSE_S = 100.0, 200, 0.5
S0 = {"sensor": "s0"}
SETTINGS = (BUS + SENSOR.format(number=0, side=32)).replace("wiener", "auto")


def write(path: Path, minutes: float, service: Service) -> None:
    """A recording as candump writes it."""
    sensor = service.sensor("s0")
    one = player(sensor.array, sensor.plan.kernel, sensor.codec, sensor.plan.calibration, "fingertip", 0.2)
    frames = [one.messages(sequence, 0.0, 0.0) for sequence in range(256)]
    with path.open("w") as file:
        for number in range(int(60 * minutes * RATE_HZ)):
            for segment, each in enumerate(frames[number % len(frames)]):
                when = 1.76e9 + number / RATE_HZ + segment * 1e-4
                file.write(f"({when:.6f}) can0 {each.id:03X}##1{each.data.hex()} R\n")


def main() -> None:
    """Write, read, seek, print."""
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    service, folder = Service(parse(SETTINGS, "measure")), TemporaryDirectory()
    path = Path(folder.name) / "a.log"
    write(path, minutes, service)
    server = Server(port=0, recordings=path.parent, recordings_leave_mb=0, control_per_minute=0)
    with (
        folder,
        running(service, server) as url,
        httpx.Client(**HTTP, base_url=f"{url}/api/v1/recordings/a.log") as client,
    ):
        began, first = time.monotonic(), 0.0
        while (state := client.get("/playback", params=S0).json())["reading"]:
            if state["frames"] and not first:
                first = time.monotonic() - began
            time.sleep(PAUSE_S)
        read_s = time.monotonic() - began
        print(
            f"{path.stat().st_size / 1e6:.0f} MB, {state['frames']} frames: "
            f"the first read after {first:.1f} s, all after {read_s:.0f} s"
        )
        times = []
        for at in np.random.default_rng(1).uniform(0, state["duration_s"], SEEKS):
            start = time.perf_counter()
            answer = client.get("/frames", params=S0 | {"at": at})
            times.append(1e3 * (time.perf_counter() - start))
            assert abs(float(answer.headers["x-tactiled-positions"]) - at) < 2 / RATE_HZ
        print(
            f"{SEEKS} seeks: median {np.median(times):.1f} ms, 99 % {np.quantile(times, 0.99):.1f}, "
            f"longest {max(times):.1f}"
        )
        print(f"memory of the service at most {getrusage(RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
