"""What painting leaves to the garbage collector, counted by frames and not by time."""

import threading
from collections import Counter

from tests.viewer.conftest import wait
from tests.viewer.measure import SAMPLING, allocated
from tests.viewer.test_viewer import PAINTINGS, painted

# What is not compiled yet makes an object of every fraction: compile what paints at once, not in half a minute.
SOON = (
    "--js-flags=--no-concurrent-recompilation --interrupt-budget=2000"
    " --invocation-count-for-maglev=20 --invocation-count-for-turbofan=40"
)
WARM, FRAMES = 500, 200  # frames before, and watched
MOST = 2500  # bytes a frame in the viewer's own functions
STOP = "for (let i = 1; i < 1000; i += 1) clearInterval(i)"  # what comes by time: words and looks at lists


def test_a_painted_frame_leaves_next_to_no_garbage(rig, url, launch, open_page):
    stop = threading.Event()
    sender = rig.play(75, stop)
    page = open_page(url, browser=launch(SOON))
    page.evaluate(STOP)
    session = page.context.new_cdp_session(page)
    wait(page, f"{PAINTINGS} > {WARM}")
    session.send("HeapProfiler.startSampling", {**SAMPLING, "samplingInterval": 256})
    before = painted(page)
    wait(page, f"{PAINTINGS} > {before + FRAMES}")
    profile, frames = session.send("HeapProfiler.stopSampling")["profile"], painted(page) - before
    stop.set()
    sender.join()
    by_function = allocated(profile["head"], Counter())
    ours = {name: size / frames for name, size in by_function.items() if ".js " in name}
    assert len(ours) > 10  # it did look
    assert sum(ours.values()) < MOST, sorted(ours.items(), key=lambda each: -each[1])[:10]
