import assert from "node:assert/strict";
import test from "node:test";

import { calibration, calibrationAction } from "../../tactiled/web/static/wire/api.js";
import { chartOf } from "../../tactiled/web/static/calibration/calibration_result.js";
import { coverNotes, coverRows, gainRows, tareText, taxelText, verdict, zoneText } from "../../tactiled/web/static/calibration/calibration_text.js";

const cover = {
  thickness_mm: 1.183, interval_mm: [1.151, 1.214], before_mm: 1.5, presses: 20, residual: 1.07, reason: "", notes: ["a note"],
  line: { x_mm: [2, -1, 0, 1], measured: [0.1, 0.5, 1, null], fitted: [0.1, 0.52, 0.98, 0.5] },
};
const gain = {
  form: "power", kpa_per_count: -0.05123, interval_kpa_per_count: [-0.0519, -0.0505], before_kpa_per_count: null,
  spread_percent: 18.34, hysteresis_percent: null, notes: [], line: { counts: [0, 100], measured_kpa: [0, 5], fitted_kpa: [0, 5.1] },
};

test("a result stands beside its interval and what was before", () => {
  assert.deepEqual(coverRows(cover), [["thickness, mm", "1.18", "1.15 to 1.21", "1.50"]]);
  assert.deepEqual(gainRows(gain), [
    ["gain, kPa per count", "−0.05123", "−0.0519 to −0.0505", "none"], ["spread over taxels, %", "18", "", ""],
  ]);
});

test("a weight that was laid on once has no interval", () => {
  assert.equal(gainRows({ ...gain, interval_kpa_per_count: null })[0][2], "unknown");
});

test("the verdict says what changed, or why nothing can be told", () => {
  assert.match(verdict({ cover }), /thinner than/);
  assert.match(verdict({ cover: { ...cover, before_mm: 1.1 } }), /thicker than/);
  assert.match(verdict({ cover: { ...cover, before_mm: 1.2 } }), /agrees/);
  assert.equal(verdict({ cover: { ...cover, reason: "nothing sharp" } }), "This cannot tell the thickness: nothing sharp.");
  assert.equal(verdict({ cover: { ...cover, reason: "too thin?" } }), "This cannot tell the thickness: too thin?");
  assert.deepEqual(coverNotes({ ...cover, reason: "nothing sharp" }, "tip"), ["a note"]);
  assert.deepEqual(coverNotes(cover, "edge"), ["Fitted to 20 edges. What it gives for edges that the fit did not use is off by 1.07 times what noise and gain errors explain.", "a note"]);
});

test("a chart has the fitted line and the measured points in the order of their places, unknown ones left out", () => {
  const { axes, lines: [fitted, measured] } = chartOf({ cover, gain: null });
  assert.deepEqual([...fitted.x], [-1, 0, 1, 2]);
  assert.deepEqual([...fitted.y], [0.52, 0.98, 0.5, 0.1]);
  assert.deepEqual([[...measured.x], measured.style], [[-1, 0, 2], "points"]);
  assert.ok(axes.left < -1 && axes.right > 2 && axes.bottom <= 0 && axes.top > 1);
  assert.deepEqual([...chartOf({ cover: null, gain }).lines[1].y], [0, 5]);
  assert.equal(chartOf({ cover: { ...cover, line: null }, gain: null }), null);
});

test("a zone and a tare say how far they are", () => {
  assert.deepEqual(zoneText(1, 2), { text: "1 of 2", done: false });
  assert.deepEqual(zoneText(3, 2), { text: "✓ 3", done: true });
  assert.deepEqual([tareText(null), tareText(200)], ["none since the start", "3 min ago"]);
});

test("a request that has no answer in time says how long it was waited for", async (t) => {
  t.mock.method(AbortSignal, "timeout", (ms) => ms);
  t.mock.method(globalThis, "fetch", async () => { throw new DOMException("", "TimeoutError"); });
  await assert.rejects(calibration("palm"), { message: "no answer within 8 s" });
  await assert.rejects(calibrationAction("palm", "apply"), { message: "no answer within 60 s" });
  assert.deepEqual(fetch.mock.calls.map((each) => each.arguments[1].signal), [8000, 60_000]);
});

test("taxels that are left out are named, three at most", () => {
  const faults = [17, 18, 19, 20].map((taxel) => ({ taxel, fault: "stuck" }));
  assert.equal(taxelText([], [], "as configured"), "all work");
  assert.equal(taxelText([], [], "row 1 in reverse order"), "wrong map: row 1 in reverse order");
  assert.equal(taxelText([3], [], "row 1 in reverse order"), "1 left out: 1 configured as dead; wrong map: row 1 in reverse order");
  assert.equal(taxelText([3], faults.slice(0, 1)), "2 left out: 17 stuck, 1 configured as dead");
  assert.equal(taxelText([], faults), "4 left out: 17 stuck, 18 stuck, 19 stuck, 1 more");
});
