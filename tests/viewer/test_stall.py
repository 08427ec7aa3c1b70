"""A page that stood still shows, when it goes on, nothing that waited meanwhile; told by what is on the canvas."""

import base64
import struct
import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from tests.conftest import NO_LOAD, SIDE, pressed
from tests.viewer.conftest import keep, turned, wait
from tests.viewer.test_viewer import PAINTINGS, painted, pixels
from tests.viewer.test_wall import LEVELS

OLD_S = 0.1
BITS = 32
SINGLE, WALL = "#raw", ".tile canvas"
# After every turn of the screen: which frame is on the canvas, by its bright taxels, and when that turn began.
WATCH = """selector => {
  window.seen = [];
  const real = window.requestAnimationFrame.bind(window);
  const look = at => {
    const canvas = document.querySelector(selector);
    const { data } = canvas.getContext("2d").getImageData(0, 0, 8, 8);
    const level = i => data[4 * i] + data[4 * i + 1] + data[4 * i + 2];
    let number = 0;
    for (let i = 0; i < 32; i += 1) if (level(i) > level(63) / 2) number += 2 ** i;
    window.seen.push([number, at]);
  };
  window.requestAnimationFrame = turn => real(now => {
    const at = Date.now() / 1000;
    turn(now);
    look(at);
  });
}"""
QUICK = (
    "window.seen.length > 60 && window.seen.slice(-5).every(([, at], i, all) => !i || at - all[i - 1][1] < 0.09)"
)
BLOCK = """setTimeout(() => {
  for (const end = Date.now() + 1500; Date.now() < end;);
  window.wentOn = Date.now() / 1000;
}, 0)"""
# What a hidden tab does: messages come, but the screen has no turns.
HIDE = """() => {
  const shown = window.requestAnimationFrame;
  const waiting = [];
  window.requestAnimationFrame = turn => waiting.push(turn);
  setTimeout(() => {
    window.wentOn = Date.now() / 1000;
    window.requestAnimationFrame = shown;
    for (const turn of waiting) shown(turn);
  }, 1500);
}"""


def numbered(number):
    """Counts of a frame whose bright taxels spell its number; the last taxel is always bright."""
    bits = np.zeros(SIDE**2, int)
    bits[:BITS] = [number >> at & 1 for at in range(BITS)]
    bits[-1] = 1
    return NO_LOAD + 1000 * bits


def play(rig, stop):
    """Send numbered frames, fifty a second."""

    def go():
        while not stop.wait(0.02):
            rig.send(numbered(rig.sequence + 1))

    sender = threading.Thread(target=go)
    sender.start()
    return sender


def sent(payloads):
    """When the service sent each image that the page was sent, by its number."""
    heads = [base64.b64decode(each[:56])[:40] for each in payloads]
    return dict(struct.unpack("<16xQ8xd", head) for head in heads)


@pytest.mark.parametrize("still", [BLOCK, HIDE], ids=["blocked", "hidden"])
@pytest.mark.parametrize("canvas", [SINGLE, WALL], ids=["single", "wall"])
def test_what_waited_while_the_page_stood_still_is_not_painted(pair, open_page, canvas, still):
    rig, url = pair
    rig.sensor.pipeline.set_method("raw")
    stop, payloads = threading.Event(), []
    sender = play(rig, stop)
    try:
        live = "document.body.dataset.level === 'live'" if canvas == SINGLE else f"{LEVELS}[0] === 'live'"
        page = open_page(url if canvas == SINGLE else f"{url}/#/wall", ready=live)
        session = page.context.new_cdp_session(page)
        session.send("Network.enable")
        session.on(
            "Network.webSocketFrameReceived",
            lambda got: (
                payloads.append(got["response"]["payloadData"]) if got["response"]["opcode"] == 2 else None
            ),
        )
        page.evaluate(WATCH, canvas)
        wait(page, QUICK)
        for _ in range(5):  # on a busy machine nothing may be sent meanwhile
            began = time.time()
            page.evaluate("window.wentOn = 0")
            page.evaluate(still)
            wait(page, "window.wentOn && window.seen.filter(([, at]) => at > window.wentOn).length > 20")
            seen, went_on = page.evaluate("window.seen"), page.evaluate("window.wentOn")
            at_sent = sent(payloads)
            waited = [number for number, at in at_sent.items() if began < at < went_on - OLD_S]
            if waited:
                break
    finally:
        stop.set()
        sender.join()
    assert waited  # there was something old to paint
    at_sent = sent(payloads)
    changes = [(number, at) for (before, _), (number, at) in pairwise(seen) if number != before]
    after = [(number, at) for number, at in changes if at > went_on]
    assert len({number for number, _ in after}) > 5
    assert not [
        at - at_sent[number] for number, at in after if at_sent[number] < went_on and at - at_sent[number] > OLD_S
    ]


# After every turn of a screen that takes longer over each than an image may be old: how bright the canvas is.
SLOW = """selector => {
  window.seen = new Set();
  const real = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = turn => real(() => setTimeout(() => {
    turn(performance.now());
    const { data } = document.querySelector(selector).getContext("2d").getImageData(0, 0, 8, 8);
    window.seen.add(data.join());
  }, 150));
}"""


@pytest.mark.parametrize("canvas", [SINGLE, WALL], ids=["single", "wall"])
def test_a_page_that_is_slow_at_painting_goes_on_painting(pair, open_page, canvas):
    rig, url = pair
    rig.sensor.pipeline.set_method("raw")
    stop = threading.Event()
    page = open_page(url if canvas == SINGLE else f"{url}/#/wall", ready=f"!!document.querySelector('{canvas}')")
    sender = play(rig, stop)
    try:
        wait(page, "document.body.dataset.level === 'live'" if canvas == SINGLE else f"{LEVELS}[0] === 'live'")
        page.evaluate(SLOW, canvas)
        page.evaluate("new Promise(done => setTimeout(() => done(window.seen.clear()), 500))")
        wait(page, "window.seen.size > 10", 20)
    finally:
        stop.set()
        sender.join()


# [ms that an image was under way, ms that the page then stands still, images not painted yet]: is it held back?
TOLD = """async turns => {
  const { Freshness } = await import("/static/freshness.js");
  const present = new Freshness();
  const real = Date.now;
  let now = 1e12;
  Date.now = () => now;
  const told = turns.map(([way, still, count]) => {
    present.hear((now - way) / 1000);
    now += still;
    const late = present.late((now - way - still) / 1000, count);
    if (!late) present.painted();
    now += 20;
    return late;
  });
  Date.now = real;
  return told;
}"""


@pytest.mark.parametrize(
    ("turns", "late"),
    [
        ([[2, 0, 1], [2, 30_000, 2], [2, 0, 1]], [False, True, False]),
        ([[2, 0, 1], [150, 0, 1], [2, 30_000, 2], [2, 30_000, 2], [2, 0, 1]], [False, True, True, True, False]),
        ([[2, 0, 1]] + 6 * [[150, 0, 1]], [False] + 4 * [True] + 2 * [False]),
        ([[2, 0, 1]] + 6 * [[2, 150, 1]], [False] + 4 * [True] + 2 * [False]),
    ],
    ids=["stood", "stood again before anything was painted", "a slow way", "a slow page"],
)
def test_nothing_old_is_painted_but_where_all_is_late(rig, url, open_page, turns, late):
    rig.show(pressed())
    assert open_page(url).evaluate(TOLD, turns) == late


STEP = "(() => { const real = Date.now; Date.now = () => real() + 10_000; })()"


def test_a_clock_that_is_set_stops_nothing(rig, url, open_page):
    stop = threading.Event()
    sender = rig.play(50, stop)
    page = open_page(url)
    wait(page, "document.body.dataset.level === 'live'")
    page.evaluate(STEP)
    began = painted(page)
    wait(page, f"{PAINTINGS} > {began + 20}")
    stop.set()
    sender.join()


@pytest.mark.parametrize("stale_after_s", [0.3, 4.0], ids=["meanwhile", "later"])
def test_the_last_frame_before_a_silence_is_shown_though_it_waited(rig, url, open_page, stale_after_s):
    rig.show(pressed(0))
    page = open_page(url)
    keep(lambda: rig.show(pressed(1)), page, "document.body.dataset.level === 'live'")
    rig.stale_after(stale_after_s)
    turned(page)
    before = painted(page)
    page.evaluate(HIDE)
    image = rig.show(pressed(5))
    wait(page, "window.wentOn && document.body.dataset.level === 'stale'")
    wait(page, f"document.getElementById('sequence').innerText === '{image.sequence}'")
    wait(page, f"{PAINTINGS} > {before}")
    turned(page)
    assert pixels(page, "raw")[3, 5, :3].sum() > 3 * pixels(page, "raw")[3, 1, :3].sum()
