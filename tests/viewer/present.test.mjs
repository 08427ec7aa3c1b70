import assert from "node:assert/strict";
import test from "node:test";

import { events } from "../../tactiled/web/static/wire/api.js";
import { addEvent } from "../../tactiled/web/static/shell/event_rows.js";
import { FrameRate } from "../../tactiled/web/static/shell/frame_rate.js";
import { Freshness } from "../../tactiled/web/static/shell/freshness.js";
import { healthOf } from "../../tactiled/web/static/shell/health.js";
import { Timeline, timeOffset } from "../../tactiled/web/static/shell/timeline.js";
import { View } from "../../tactiled/web/static/shell/view.js";
import { Warnings } from "../../tactiled/web/static/shell/warnings.js";

/** Which of these images are held back: each took `way` ms,
  then the page stood `still` ms with `count` not painted. */
function heldBack(turns) {
  const freshness = new Freshness();
  let now = 1e9;
  return turns.map(([way, still, count]) => {
    const sent = now - way / 1000;
    freshness.arrived(sent, now);
    now += still / 1000;
    const held = freshness.holdBack(sent, count, now);
    if (!held) freshness.painted();
    now += 0.02;
    return held;
  });
}

test("an old image is held back, unless all are late", () => {
  const late = Array(4).fill(true);
  const again = Array(6).fill([150, 0, 1]);
  for (const [what, turns, held] of [
    ["the page stood still", [[2, 0, 1], [2, 30_000, 2], [2, 0, 1]], [false, true, false]],
    ["it did so again before it painted", [[2, 0, 1], [150, 0, 1], [2, 30_000, 2], [2, 30_000, 2], [2, 0, 1]],
      [false, true, true, true, false]],
    ["a slow network, or a clock that was set", [[2, 0, 1], ...again], [false, ...late, false, false]],
    ["a slow page", [[2, 0, 1], ...Array(6).fill([2, 150, 1])], [false, ...late, false, false]],
  ]) assert.deepEqual(heldBack(turns), held, what);
});

test("a late image is shown once the service says that there is no newer one", () => {
  const freshness = new Freshness();
  const newest = (state, sequence, after) => freshness.noneNewer({ ...live, state, sequence }, 7, 100 + after);
  freshness.arrived(99.998, 100);
  assert.ok(!newest("stale", 7, 1)); // nothing is held back
  assert.ok(freshness.holdBack(99, 1, 100));
  assert.deepEqual([newest("stale", 7, 0), newest("live", 7, 0.6), newest("live", 7, 0.4), newest("live", 8, 0.6)],
    [true, true, false, false]);
});

test("latency leaves out the clocks' difference where it is large", () => {
  const now = 1e9;
  Date.now = () => 1000 * now;
  Object.defineProperty(globalThis, "performance", { value: { now: () => 5000 }, configurable: true });
  const rate = new FrameRate();
  const latency = (frame, skew) => {
    rate.paint(performance.now(), frame, skew);
    return [Math.round(rate.latency), rate.skew];
  };
  assert.deepEqual(latency({ sent: now - 0.1, timestamp: now - 0.3 }, 0.002), [300, 0]);
  assert.deepEqual(latency({ sent: now - 10.1, timestamp: now - 10.3 }, 10), [300, 10]);
  assert.equal(rate.fps(), 2);
  rate.paint(performance.now() - 2000, { sent: now, timestamp: now }, 0);
  assert.equal(rate.fps(), 2);
});

test("a warning stays five seconds after it was last reported, with its newest text", () => {
  const warnings = new Warnings();
  const dead = (text) => [{ code: "dead", text, taxels: null }];
  assert.deepEqual(warnings.hold(dead("2 taxels dead"), 0), ["2 taxels dead"]);
  assert.deepEqual(warnings.hold(dead("1 taxel dead"), 1000), ["1 taxel dead"]);
  assert.deepEqual([warnings.hold([], 5900), warnings.hold([], 6001)], [["1 taxel dead"], []]);
  const cut = (now) => warnings.hold([{ code: "cut_short", text: "cut", taxels: null }], now).length;
  const counts = Array.from({ length: 12 }, (_, i) => cut(10_000 + 1000 * i)); // it lasts ten seconds
  assert.deepEqual(counts, [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1]);
  const both = warnings.hold([{ code: "cut_short", text: "cut", taxels: null }, ...dead("1 taxel dead")], 21_500);
  assert.deepEqual(both, ["1 taxel dead", "cut"]); // a little less sharp is said last
  assert.equal(cut(30_000), 0); // and begins again after a gap
  const early = [{ code: "noise_unknown", text: "early", taxels: null }];
  assert.deepEqual(warnings.hold(early, 30_100), []); // by itself
});

test("what belongs to some frames is shown with the nearest one, within a limit and with the offset", () => {
  const timeline = new Timeline(3, 0.25);
  const at = (sequence) => ({ sequence, timestamp: sequence / 10 });
  for (const sequence of [1, 20, 22, 30]) timeline.push(at(sequence));
  const nearest = (sequence) => timeline.at(sequence / 10)?.sequence;
  assert.deepEqual([20, 20.5, 21.5, 24, 25.5, 33, 1].map(nearest), [20, 20, 22, 22, undefined, undefined,
    undefined]);
  assert.deepEqual([20, 21, 19].map((each) => timeOffset(at(20), at(each))), ["", "100 ms earlier",
    "100 ms later"]);
});

const open = { link: "open", reason: "", retryAt: 0, attempts: 0, lastMessageAt: 9500, requestedAt: 0 };
const live = { state: "live", age_s: 0.5, rate_hz: 50, detail: "" };

test("only what is the present is called live", () => {
  const level = (stream, status) => {
    const health = healthOf(stream, stream, status, 9000, 0, 10_000);
    return [health.level, health.text];
  };
  for (const [what, stream, status, expected, text] of [
    ["no status", open, null, "connecting", /^$/],
    ["live", open, live, "live", /^$/],
    ["closed", { ...open, link: "closed", retryAt: 12_500, reason: "moved" }, live, "disconnected",
      /^Retrying in 3 s. Last frame 1.5 s ago. \(moved\)$/],
    ["again", { ...open, link: "connecting", attempts: 1 }, null, "disconnected", /^Retrying now. No frame yet.$/],
    ["no message", { ...open, lastMessageAt: 7000 }, live, "disconnected", /^No message for 3.0 s/],
    ["bus down", open, { ...live, state: "down", detail: "no can0" }, "down", /^no can0. Last frame 1.5 s ago.$/],
    ["silent", open, { ...live, state: "silent", detail: "no frame yet on can0", age_s: null }, "silent",
      /^no frame yet/],
    ["an end", open, { ...live, state: "ended", detail: "a.log has ended" }, "ended", /^a.log has ended.$/],
    ["stale", open, { ...live, state: "stale", detail: "no frame for 1 s" }, "stale", /^last frame 1.5 s ago.$/],
    ["no image", { ...open, requestedAt: 7500 }, live, "stale", /^last image 2.5 s ago, though frames come in.$/],
    ["a slow sensor", { ...open, requestedAt: 7500 }, { ...live, rate_hz: 1 }, "live", /^$/],
  ]) {
    const [got, words] = level(stream, status);
    assert.equal(got, expected, what);
    assert.match(words, text, what);
  }
});

test("what repeats in the log of events is one row with its count", () => {
  const rows = [];
  const add = (time, kind, text, code, sensor = "palm") =>
    addEvent(rows, { time, kind, text, sensor, bus: null, warning: code ? { code } : null });
  for (let i = 0; i < 12; i += 1) {
    add(2 * i, "warning_raised", `${i} taxels did not arrive`, "missing");
    add(2 * i + 0.5, "warning_raised", "restoring took longer than 1 ms", "cut_short");
    add(2 * i + 1, "warning_cleared", `${i} taxels did not arrive`, "missing");
  }
  const of = () => rows.map(({ event, count, since }) => [event.kind, event.text, count, since]);
  assert.deepEqual(rows.map(({ begun }) => begun), [22, 22.5]); // of what is over, when it last began
  assert.deepEqual(of(), [
    ["warning_cleared", "11 taxels did not arrive", 12, 0],
    ["warning_raised", "restoring took longer than 1 ms", 12, 0.5],
  ]);
  add(30, "warning_raised", "1 taxel did not arrive", "missing", "thumb");
  add(700, "warning_raised", "1 taxel did not arrive", "missing");
  for (const [time, text] of [[701, "by hand: nnls"], [702, "by hand: tv"], [703, "by hand: tv"]]) add(time, "method_set", text);
  assert.deepEqual(of().slice(0, 4).map(([, , count]) => count), [2, 1, 1, 1]);
  assert.equal(rows.length, 6);
  rows.length = 0;
  add(0, "sensor_live", "frames come");
  for (const [time, region] of [[1, "heel"], [2, "toe"]]) add(time, "region_above", `region ${region}: force ${time} is above 1 N`);
  for (const time of [3, 5]) {
    add(time, "sensor_stale", `no frame for ${time} s`);
    add(time + 1, "sensor_live", "frames come");
  }
  add(7, "region_below", "region heel: force 0.5 is below 0.9 N");
  assert.deepEqual(of(), [
    ["region_below", "region heel: force 0.5 is below 0.9 N", 1, 1], ["sensor_live", "frames come", 2, 3],
    ["region_above", "region toe: force 2 is above 1 N", 1, 2], ["sensor_live", "frames come", 1, 0],
  ]);
});

/** Answer each request with the JSON that this makes of its query. */
function answerBy(make) {
  globalThis.fetch = async (path) => new Response(JSON.stringify(await make(new URL(path, "http://host").searchParams)));
}

test("the log asks for all events that the service has", async () => {
  answerBy((query) => ({ events: Array.from({ length: query.get("limit") ?? 100 }, (_, i) => ({ id: i + 1 })), newest: 1000 }));
  const answer = await events(0);
  assert.equal(answer.events.at(-1).id, answer.newest);
});

test("of two colour maps the one that was chosen last is shown, whichever comes first", async () => {
  const elements = {};
  globalThis.document = {
    getElementById: (id) => elements[id] ??= { options: [], dataset: {}, classList: { toggle() {} }, style: { setProperty() {} }, addEventListener() {} },
  };
  globalThis.location = { hash: "" };
  const view = new View([], null, () => {});
  let answerFirst;
  const later = new Promise((resolve) => { answerFirst = resolve; });
  answerBy(async (query) => {
    if (query.get("name") === "turbo") await later;
    return { colors: [[query.get("name").length, 0, 0]] };
  });
  const loads = ["turbo", "grey"].map((name) => {
    elements.colors.value = name;
    return view.load();
  });
  await loads[1];
  answerFirst();
  await loads[0];
  assert.equal(view.colormap.css[0], `rgb(${"grey".length} 0 0)`);
});
