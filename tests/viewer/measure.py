"""python -m tests.viewer.measure [SECONDS] [--apart]: what the viewer costs the browser at 64 x 64; prints only.

CPU is the page's main thread's own time, of one core; garbage is what V8's sampling profiler saw allocated, the
viewer's own functions apart from what the browser and the measuring itself allocate, and how long collecting it
held the page up. The frames are made before: to simulate them meanwhile would make them late. What limits the
frame rate is told apart by the screen's turns: how many the browser gave, how many of them brought nothing new,
and how many a page gets that does no more than fill two canvases of the maps' size. `--apart` keeps the service
on one core and the browser on the others.
"""

import json
import os
import shutil
import sys
from collections import Counter
from threading import Event, Thread

from playwright.sync_api import Browser, CDPSession, Page, sync_playwright
from threadpoolctl import threadpool_limits

from tactiled.bus.reader import open_bus
from tactiled.config import parse
from tactiled.runtime.service import Service
from tactiled.simulate import play, player
from tactiled.web.server import running

SIDE = 64  # taxels
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
TURNS = """() => {
  const seen = window.turns = { count: 0, idle: 0, last: "" };
  const turn = () => {
    const { painted } = document.documentElement.dataset;
    seen.count += 1;
    if (painted === seen.last) seen.idle += 1;
    seen.last = painted;
    requestAnimationFrame(turn);
  };
  requestAnimationFrame(turn);
}"""
EMPTY = """([side, width]) => {
  const pens = [0, 1].map(() => {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = side;
    canvas.style.width = canvas.style.height = `${width}px`;
    canvas.style.imageRendering = "pixelated";
    document.body.append(canvas);
    return canvas.getContext("2d");
  });
  const image = pens[0].createImageData(side, side);
  const words = new Uint32Array(image.data.buffer);
  const seen = window.turns = { count: 0, idle: 0 };
  const turn = () => {
    seen.count += 1;
    for (let i = 0; i < words.length; i += 1) words[i] = 0xff000000 | (i * seen.count);
    for (const pen of pens) pen.putImageData(image, 0, 0);
    requestAnimationFrame(turn);
  };
  document.body.replaceChildren(...pens.map(pen => pen.canvas));
  requestAnimationFrame(turn);
}"""


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


def turns(page: Page, seconds: float) -> tuple[float, float]:
    """The screen's turns a second that a page gets, and those of them that painted nothing new."""
    look = "[window.turns.count, window.turns.idle, performance.now()]"
    page.wait_for_timeout(1000)
    before = page.evaluate(look)
    page.wait_for_timeout(1000 * seconds)
    count, idle, ms = (now - then for now, then in zip(page.evaluate(look), before, strict=True))
    return 1000 * count / ms, 1000 * idle / ms


def limits(page: Page, seconds: float) -> None:
    """Print what limits the frame rate; the page is another in the end."""
    width = page.evaluate("document.getElementById('raw').clientWidth")
    page.evaluate(TURNS)
    given, idle = turns(page, seconds)
    page.goto(page.url.split("#")[0] + "api/v1/colormap")
    page.evaluate(EMPTY, [SIDE, width])
    empty, _ = turns(page, seconds)
    print(
        f"{given:.1f} turns of the screen a second, {idle:.1f} of them with no new image; {empty:.1f} of a page "
        f"with two canvases of {width} px and nothing else; load average {os.getloadavg()[0]:.1f}"
    )


def pauses(browser: Browser, page: Page, seconds: float) -> None:
    """Print how often and for how long the page stood still while garbage was collected."""
    browser.start_tracing(page=page, categories=["devtools.timeline"])
    page.wait_for_timeout(1000 * seconds)
    events = json.loads(browser.stop_tracing())["traceEvents"]
    found = [each["dur"] / 1000 for each in events if each["name"] in ("MinorGC", "MajorGC")]
    print(
        f"collections in {seconds:.0f} s: {len(found)}, longest {max(found, default=0.0):.2f} ms, "
        f"together {sum(found):.2f} ms"
    )


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


def main(seconds: float, apart: bool) -> None:
    """Serve a simulated array, open the viewer, measure."""
    cores = sorted(os.sched_getaffinity(0))
    if apart:  # threads and processes begin on the cores of the thread that starts them
        os.sched_setaffinity(0, cores[:1])
    service, stop = Service(parse(CONFIG, "measure")), Event()
    sensor, end = service.sensor("palm"), open_bus(interface="virtual", channel="measure")
    one = player(sensor.array, sensor.plan.kernel, sensor.codec, sensor.plan.calibration, "fingertip", 0.2)
    made = [one.messages(sequence, sequence / RATE_HZ, 0.0) for sequence in range(FRAMES)]
    sender = Thread(
        target=play, args=(lambda sequence, *_: made[sequence % FRAMES], end.send, RATE_HZ, stop), daemon=True
    )
    with threadpool_limits(1), running(service) as url:
        service.start()
        sender.start()
        if apart:
            os.sched_setaffinity(0, cores[1:])
        watch(url, service, seconds)
    stop.set()
    sender.join()
    service.stop()
    end.close()


def watch(url: str, service: Service, seconds: float) -> None:
    """Open the viewer and measure."""
    restored: list[int] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(url)
        service.sensor("palm").hub.subscribe(lambda image: restored.append(image.sequence))
        measure(page, restored, seconds)
        pauses(browser, page, seconds)
        limits(page, seconds)
        browser.close()


if __name__ == "__main__":
    numbers = [each for each in sys.argv[1:] if each != "--apart"]
    main(float(numbers[0]) if numbers else 30.0, "--apart" in sys.argv)
