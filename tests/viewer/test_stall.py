"""A page that stood still goes on with the present, or the newest there is; and painting leaves little garbage."""

import re
from collections import Counter

import numpy as np
import pytest

from tests.conftest import pressed
from tests.viewer.conftest import LEVEL, LEVELS, LIVE, PAINTINGS
from tests.viewer.measure import SAMPLING, allocated

PILL = "document.getElementById('pill-text').innerText"
TILE = "document.querySelector('.tile .foot .sub').innerText"
# What a hidden tab does: messages come, but the screen is not refreshed.
HIDE = """() => {
  const real = window.requestAnimationFrame;
  const waiting = [];
  window.requestAnimationFrame = paint => waiting.push(paint);
  window.show = () => {
    window.requestAnimationFrame = real;
    for (const paint of waiting) real(paint);
  };
}"""


@pytest.mark.parametrize("wall", [False, True], ids=["single", "wall"])
def test_what_waited_while_the_page_was_hidden_is_not_painted(pair, open_page, wall):
    rig, url = pair
    page = open_page(f"{url}/#/wall" if wall else url, ready="!!document.querySelector('.tile, #method option')")
    live = f"{LEVELS}.startsWith('live')" if wall else LIVE
    rig.stale_after(600)
    page.keep(lambda: rig.both(pressed(1)), live)
    page.evaluate("document.querySelector('#wall:not([hidden]) .tile canvas, #raw').id = 'map'")
    while (page.pixels("map")[..., :3].max(axis=-1) < 64).all():  # live it may be before it has painted
        rig.both(pressed(1))
        page.refreshed(4)
    before = page.pixels("map")
    for attempt in range(20):  # a page that was late before may paint what is as late
        page.keep(lambda: rig.both(pressed(1)), live)
        page.refreshed(4)
        page.evaluate(HIDE)
        rig.both(pressed(5))
        page.wait_for_timeout(5000 + 300 * attempt)  # of which a busy page takes some for the way of its images
        page.evaluate("window.show()")
        page.refreshed(4)
        if ((after := page.pixels("map")) == before).all():
            break
    np.testing.assert_array_equal(after, before)
    while (page.pixels("map") == before).all():  # nothing newer comes
        page.refreshed()
    # It says so, for two seconds; without an image for longer it is stale, which a busy page may be before.
    stale = f"{LEVELS if wall else LEVEL}.startsWith('stale')"
    page.wait(f"/, [1-9][0-9.]* s late/.test({TILE if wall else PILL}) || {stale}")
    page.keep(lambda: rig.both(pressed(1)), live)
    while (page.pixels("map") != before).any():
        rig.both(pressed(1))
        page.refreshed()
    page.keep(lambda: rig.both(pressed(1)), f"!{TILE if wall else PILL}.includes('late')")


# What is not compiled yet makes an object of every fraction: compile what paints at once, not in half a minute.
COMPILE_SOON = (
    "--js-flags=--no-concurrent-recompilation --interrupt-budget=2000"
    " --invocation-count-for-maglev=20 --invocation-count-for-turbofan=40"
)
WARM_UP, FRAMES = 300, 200  # frames before, and measured
ROUNDS = 12  # until when the slowest machine has compiled what paints
MAX_BYTES = 3000  # a frame, in the viewer's own functions: 2300
BY_TIME = re.compile(r"(api|deviation|npy|socket)\.js ")  # what comes by time, not by frames
STOP_TIMERS = "for (let i = 1; i < 1000; i += 1) clearInterval(i)"  # texts and polling


def garbage(page, session, rig):
    """Bytes a frame of each of the viewer's own functions."""
    session.send("HeapProfiler.startSampling", {**SAMPLING, "samplingInterval": 256})
    before, sent = page.painted(), rig.sequence
    page.wait(f"{PAINTINGS} > {before + FRAMES}")
    profile = session.send("HeapProfiler.stopSampling")["profile"]
    frames = max(page.painted() - before, rig.sequence - sent)  # a busy machine paints fewer than come
    by_function = allocated(profile["head"], Counter())
    return {
        name: size / frames for name, size in by_function.items() if ".js " in name and not BY_TIME.match(name)
    }


def test_a_painted_frame_leaves_little_garbage(rig, url, launch, open_page):
    with rig.playing(75):
        page = open_page(url, browser=launch(COMPILE_SOON))
        page.evaluate(STOP_TIMERS)
        session = page.context.new_cdp_session(page.page)
        page.wait(f"{PAINTINGS} > {WARM_UP}")
        for _ in range(ROUNDS):
            own = garbage(page, session, rig)
            if sum(own.values()) < MAX_BYTES:
                break
    assert len(own) > 10  # it did look
    assert sum(own.values()) < MAX_BYTES, sorted(own.items(), key=lambda each: -each[1])[:10]
