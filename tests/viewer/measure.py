"""python -m tests.viewer.measure [wall]: what the viewer costs the browser; prints only.

One array of 64 x 64 at 75 Hz; or the wall of eight of 32 x 32, each at 75 Hz. CPU is the time of the page's main
thread; garbage is what V8's sampling profiler counts as allocated, the viewer's own functions apart from the
browser's; collections are the garbage collector's.
"""

import json
import shutil
import sys
from collections import Counter
from threading import Event, Thread

from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

from tactiled.bus.reader import open_bus
from tactiled.config import parse
from tactiled.live.service import Service
from tactiled.simulate import play, player
from tactiled.web.server import running
from tests.viewer.conftest import CHROMIUM

RATE_HZ = 75.0  # of the sensor: above the screen's
FRAMES = 256  # that are simulated before and repeated: one round of the codec's sequence numbers
WARM_UP_MS = 30_000  # until the browser has compiled what paints, and the last ten seconds are full
SPAN_MS = 30_000
LATE_MS = 1000 / 60 + 50  # from one painting to the next, beyond which it is late
WALL_SENSORS = 8
BUS = """
[bus.can0]
interface = "virtual"
channel = "measure"
"""
SENSOR = """
[sensor.s{number}]
bus = "can0"
method = "wiener"
codec = {{ name = "packed", bits = 12, fd = true, array_id = {number} }}
array = {{ rows = {side}, columns = {side}, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 1.2, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.05, no_load = 100, noise_kpa = 0.2, saturation = 4000 }}
"""
SAMPLING = {
    "samplingInterval": 1024,
    "includeObjectsCollectedByMajorGC": True,
    "includeObjectsCollectedByMinorGC": True,
}
COUNT_MAPS = """
window.maps = 0;
const put = CanvasRenderingContext2D.prototype.putImageData;
CanvasRenderingContext2D.prototype.putImageData = function (...image) {
  window.maps += 1;
  put.apply(this, image);
};
"""
WATCH_PAINTINGS = """
window.gaps = [];
let before = 0;
addEventListener("DOMContentLoaded", () => new MutationObserver(() => {
  window.gaps.push(performance.now() - before);
  before = performance.now();
}).observe(document.documentElement, { attributeFilter: ["data-painted"] }));
"""
PAINTED = "Number(document.documentElement.dataset.painted)"
PAINTED_ON_WALL = f"window.maps / {WALL_SENSORS}"


def allocated(node: dict, into: Counter) -> Counter:
    """Bytes by function in a sampling profile."""
    frame = node["callFrame"]
    into[f"{frame['url'].rsplit('/', 1)[-1]} {frame['functionName'] or '(top)'}"] += node["selfSize"]
    for child in node["children"]:
        allocated(child, into)
    return into


def metrics(session: CDPSession) -> dict[str, float]:
    """Chromium's counters of the page."""
    return {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}


def measure(browser: Browser, page: Page, painted_now: str) -> None:
    """Watch a live page for three spans and print frame rate, CPU, garbage and the collector's pauses."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.wait_for_timeout(WARM_UP_MS)
    page.evaluate("gaps.length = 0")
    painted, before = page.evaluate(painted_now), metrics(session)
    page.wait_for_timeout(SPAN_MS)
    after, frames = metrics(session), page.evaluate(painted_now) - painted
    span_s = after["Timestamp"] - before["Timestamp"]
    busy_s = after["TaskDuration"] - before["TaskDuration"]
    gaps = page.evaluate("gaps")
    late = f"{sum(each > LATE_MS for each in gaps)} late by over 50 ms, the latest {max(gaps, default=0.0):.0f} ms"
    print(f"{frames / span_s:.1f} frames/s painted, {late}; main thread: {busy_s / span_s:.1%} of a core")
    session.send("HeapProfiler.startSampling", SAMPLING)
    painted = page.evaluate(painted_now)
    page.wait_for_timeout(SPAN_MS)
    profile, frames = session.send("HeapProfiler.stopSampling")["profile"], page.evaluate(painted_now) - painted
    by_function = allocated(profile["head"], Counter())
    own = sum(size for name, size in by_function.items() if ".js " in name)
    total_kb, own_kb = by_function.total() / 1e3 / frames, own / 1e3 / frames
    print(f"garbage: {total_kb:.2f} kB a frame, {own_kb:.2f} of it by the viewer's functions")
    browser.start_tracing(page=page, categories=["devtools.timeline"])
    page.wait_for_timeout(SPAN_MS)
    events = json.loads(browser.stop_tracing())["traceEvents"]
    pauses = [each["dur"] / 1000 for each in events if each["name"] in ("MinorGC", "MajorGC")]
    print(f"collections: {len(pauses)}, longest {max(pauses, default=0.0):.1f} ms, together {sum(pauses):.1f} ms")


def main() -> None:
    """Serve simulated arrays, open the viewer, measure."""
    wall = sys.argv[1:] == ["wall"]
    count, side = (WALL_SENSORS, 32) if wall else (1, 64)
    config = BUS + "".join(SENSOR.format(number=n, side=side) for n in range(count))
    service, stop = Service(parse(config, "measure")), Event()
    end = open_bus(interface="virtual", channel="measure")
    frames = [[] for _ in range(FRAMES)]
    for sensor in service.sensors.values():
        one = player(sensor.array, sensor.plan.kernel, sensor.codec, sensor.plan.calibration, "fingertip", 0.2)
        for sequence, messages in enumerate(frames):
            messages += one.messages(sequence, sequence / RATE_HZ, 0.0)
    repeat = (lambda sequence, *_: frames[sequence % FRAMES], end.send, RATE_HZ, stop)
    sender = Thread(target=play, args=repeat, daemon=True)
    with running(service) as url, sync_playwright() as playwright:
        service.start()
        sender.start()
        browser = playwright.chromium.launch(executable_path=shutil.which(CHROMIUM), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.add_init_script(COUNT_MAPS if wall else "")
        page.add_init_script(WATCH_PAINTINGS)
        page.goto(f"{url}#/wall" if wall else url)
        measure(browser, page, PAINTED_ON_WALL if wall else PAINTED)
        browser.close()
    stop.set()
    sender.join()
    service.stop()
    end.close()


if __name__ == "__main__":
    main()
