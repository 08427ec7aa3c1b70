"""python -m tests.viewer.measure [SECONDS]: what the viewer costs the browser at 64 x 64 taxels; prints only.

CPU is the page's main thread's own time, of one core; garbage is what V8's sampling profiler saw allocated, the
viewer's own functions apart from what the browser and the measuring itself allocate. The frames are made before:
to simulate them meanwhile would make them late.
"""

import os
import shutil
import sys
from collections import Counter
from threading import Event, Thread

from playwright.sync_api import CDPSession, Page, sync_playwright
from threadpoolctl import threadpool_limits

from tactiled.bus.reader import open_bus
from tactiled.config import parse
from tactiled.service import Service
from tactiled.simulate import play, player
from tactiled.web.server import running

RATE_HZ = 75.0  # of the sensor: above the screen's
FRAMES = 256  # that are played over and over: one round of the codec's sequence numbers
WARM_UP_MS = 30_000  # until the browser has compiled what paints, and the last ten seconds are full
CONFIG = """
[bus.can0]
interface = "virtual"
channel = "measure"

[sensor.palm]
bus = "can0"
method = "wiener"
codec = { name = "packed", bits = 12, fd = true }
array = { rows = 64, columns = 64, pitch_mm = 1.0 }
cover = { thickness_mm = 1.2, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.05, no_load = 100, noise_kpa = 0.2, saturation = 4000 }
"""
SAMPLING = {
    "samplingInterval": 1024,
    "includeObjectsCollectedByMajorGC": True,
    "includeObjectsCollectedByMinorGC": True,
}
PAINTED = "Number(document.documentElement.dataset.painted)"


def metrics(session: CDPSession) -> dict[str, float]:
    """Chromium's counters of the page."""
    return {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}


def allocated(node: dict, into: Counter) -> Counter:
    """Bytes by function in a sampling profile."""
    frame = node["callFrame"]
    into[f"{frame['url'].rsplit('/', 1)[-1]} {frame['functionName'] or '(top)'}"] += node["selfSize"]
    for child in node["children"]:
        allocated(child, into)
    return into


def measure(page: Page, restored: list[int], seconds: float) -> None:
    """Watch a page that is live for some seconds and print what it did."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.wait_for_timeout(WARM_UP_MS)
    painted, came, before = page.evaluate(PAINTED), len(restored), metrics(session)
    page.wait_for_timeout(1000 * seconds)
    after, frames, came = metrics(session), page.evaluate(PAINTED) - painted, len(restored) - came
    session.send("HeapProfiler.startSampling", SAMPLING)
    painted = page.evaluate(PAINTED)
    page.wait_for_timeout(1000 * seconds)
    profile = session.send("HeapProfiler.stopSampling")["profile"]
    sampled = page.evaluate(PAINTED) - painted
    by_function = allocated(profile["head"], Counter())
    total = sum(by_function.values())
    ours = sum(size for name, size in by_function.items() if ".js " in name)
    span = after["Timestamp"] - before["Timestamp"]
    print(
        f"{frames / span:.1f} frames/s painted of {came / span:.1f} restored, two maps of 64 x 64; "
        f"load average {os.getloadavg()[0]:.1f}"
    )
    busy = after["TaskDuration"] - before["TaskDuration"]
    print(f"main thread: {busy / span:.1%} of a core, {1000 * busy / max(frames, 1):.2f} ms a frame")
    grown = (after["JSHeapUsedSize"] - before["JSHeapUsedSize"]) / 1000
    print(f"heap: {after['JSHeapUsedSize'] / 1e6:.1f} MB, grown by {grown:.0f} kB in {span:.0f} s")
    print(
        f"allocated: {total / 1000 / seconds:.0f} kB/s, {total / 1000 / max(sampled, 1):.2f} kB a frame, "
        f"{ours / 1000 / max(sampled, 1):.2f} kB of it by the viewer's functions; most by"
    )
    for name, size in by_function.most_common(12):
        print(f"  {size / 1000 / seconds:8.1f} kB/s  {name}")


def main(seconds: float) -> None:
    """Serve a simulated array, open the viewer, measure."""
    service, stop = Service(parse(CONFIG, "measure")), Event()
    sensor, end = service.sensor("palm"), open_bus(interface="virtual", channel="measure")
    one = player(sensor.array, sensor.kernel, sensor.codec, sensor.calibration, "fingertip", 0.2)
    made = [one.messages(sequence, sequence / RATE_HZ, 0.0) for sequence in range(FRAMES)]
    restored: list[int] = []
    sender = Thread(
        target=play, args=(lambda sequence, *_: made[sequence % FRAMES], end.send, RATE_HZ, stop), daemon=True
    )
    with threadpool_limits(1), running(service) as url, sync_playwright() as playwright:
        service.start()
        sender.start()
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(url)
        sensor.hub.subscribe(lambda image: restored.append(image.sequence))
        measure(page, restored, seconds)
        browser.close()
    stop.set()
    sender.join()
    service.stop()
    end.close()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0)
