import assert from "node:assert/strict";
import test from "node:test";

import { gappedLine } from "../../tactiled/web/static/charts/chart.js";
import { AxisWindow, TimeWindow } from "../../tactiled/web/static/charts/chart_window.js";
import { ContactSeries } from "../../tactiled/web/static/charts/contact_series.js";
import { seriesCsv } from "../../tactiled/web/static/export/export_csv.js";
import { ForceTrace } from "../../tactiled/web/static/wire/frame_history.js";
import { Plane, cellAround } from "../../tactiled/web/static/maps/geometry.js";
import { HeldImage, mean } from "../../tactiled/web/static/maps/held_image.js";
import { measures } from "../../tactiled/web/static/maps/measures.js";
import { reportHtml } from "../../tactiled/web/static/export/report.js";
import { backAt } from "../../tactiled/web/static/charts/trend_chart.js";

/** A message with these contacts; the force of each is 0.01 N times its id. */
const message = (timestamp, ids, unit = "kPa") => ({
  timestamp, unit, contacts: ids.map((id) => ({ id, force: id / 100, peak: 20, area_mm2: 4, x_mm: id, y_mm: 2 })),
});

/** The series that these messages make. */
function seriesOf(messages, capacity) {
  const series = new ContactSeries(capacity);
  for (const each of messages) series.push(message(...each));
  return series;
}

test("a contact has its values at every message, and a gap where a message came without it", () => {
  const series = seriesOf([[1, [1, 2]], [1.05, [2]], [1.1, [1, 2]], [1.5, [3]]]);
  const { time, force, mean, x } = series.of(1, 60);
  assert.deepEqual([time, force, x], [[1, 1.1, 1.1], [0.01, null, 0.01], [1, null, 1]]);
  assert.equal(mean[0], 2.5); // 0.01 N on 4 mm²
  assert.deepEqual(series.of(2, 60).force, [0.02, 0.02, 0.02]);
  assert.deepEqual(series.of(2, 0.45).time, [1.05, 1.1]);
  assert.deepEqual(series.of(2, 0.02, 1.06).time, [1.05]);
  assert.deepEqual(series.contacts, [{ id: 3, ended: false }, { id: 2, ended: true }, { id: 1, ended: true }]);
});

test("a message that comes again adds nothing, and one of another unit or an earlier time begins anew", () => {
  const messages = [[5, [1]], [5, [1]]];
  assert.deepEqual(seriesOf(messages).of(1, 60).time, [5]);
  assert.deepEqual(seriesOf([...messages, [4, [1]]]).of(1, 60).time, [4]);
  const counts = seriesOf([...messages, [6, [1], "counts"]]).of(1, 60);
  assert.deepEqual([counts.unit, counts.time, counts.mean], ["counts", [6], [0.0025]]);
});

test("the newest values stay where there are more than it holds", () => {
  const series = seriesOf([[1, [1, 2]], [2, [1, 2]], [3, [1, 2]]], 3);
  assert.deepEqual([series.of(1, 60).time, series.of(2, 60).time], [[3], [2, 3]]);
});

test("a line ends where a value is not known, or the next comes too late", () => {
  const { x, y, length } = gappedLine([1, 2, 3, 9], [5, null, 6, 7], 2, "series1");
  assert.deepEqual([[...x], [...y], length], [[1, 2, 3, 9, 9], [5, NaN, 6, NaN, 7], 5]);
});

test("a CSV of series has a line for each value, with units and what else is said of them", () => {
  const series = seriesOf([[1, [7]], [1.05, []], [1.1, [7]]]);
  const all = new Map([
    ["contact 7", series.of(7, 60)],
    ["region left heel", { unit: "kPa", time: [1], force: [3], mean: [1.25], peak: [null], area: [9] }],
  ]);
  const lines = seriesCsv(all, 0, [["sensor", "palm"]]).split("\n");
  assert.equal(lines[0], "# sensor: palm");
  assert.deepEqual(lines.slice(2), [
    "time_s,kind,name,force_N,mean_kPa,peak_kPa,area_mm2,x_mm,y_mm",
    "1.000000,contact,7,0.07,17.5,20,4,7,2", "1.100000,contact,7,0.07,17.5,20,4,7,2",
    "1.000000,region,left heel,3,1.25,,9,,", "",
  ]);
  assert.match(seriesCsv(all, 1, []), /force_counts_mm2,mean_counts,peak_counts/);
});

test("a click marks the restored cell that it meets, a drag beyond it none", () => {
  const positions_mm = Array.from({ length: 6 }, (_, i) => [2 * (i % 3), 2 * Math.floor(i / 3)]);
  const plane = new Plane({
    shape: [2, 3], positions_mm, pitch_mm: 2, aperture: "square", aperture_mm: 2, areas_mm2: null,
    raw: { rows: 2, columns: 3 }, restored: { rows: 4, columns: 6, cell_mm: 1, origin_mm: [-0.5, -0.5], mask: null },
  });
  assert.deepEqual(cellAround(plane, [[0.1, 0.9], [0.4, 0.6]]), { name: "cell r1 c1", corners: [[0, 0], [1, 1]] });
  assert.equal(cellAround(plane, [[0.1, 0.9], [0.1, 1.1]]), null);
  assert.equal(cellAround(plane, [[-5, 0], [-5, 0]]), null);
});

const NONE = () => {};

test("all live charts share a time axis that is zoomed, panned, and follows the newest frame again", () => {
  const time = new TimeWindow(NONE);
  assert.deepEqual(time.ends(1000), [-10, 0]);
  time.zoom(0.5);
  assert.deepEqual([time.ends(1001), time.text], [[-20, 0], "last 20 s"]);
  time.pan(-1);
  assert.deepEqual([time.ends(1003), time.text], [[-42, -22], "42 to 22 s ago"]); // it stays where it is
  time.zoom(2, 0);
  assert.deepEqual(time.ends(1003), [-42, -32]);
  time.zoom(1e-9);
  assert.deepEqual([time.span, time.zoomed], [600, false]);
  time.reset(60);
  assert.deepEqual(time.ends(1003), [-60, 0]);
});

test("a part of an axis stays within it, and is all again where it would be more", () => {
  const part = new AxisWindow(NONE);
  part.limit(0, 32);
  part.zoom(4, 0.25);
  assert.deepEqual([part.left, part.right], [6, 14]);
  part.pan(5);
  assert.deepEqual([part.left, part.right], [24, 32]);
  part.limit(0, 16); // of another axis
  assert.deepEqual([part.left, part.right], [8, 16]);
  part.zoom(0.1);
  assert.deepEqual([part.zoomed, part.left, part.right], [false, 0, 16]);
});

test("forces are kept in rings, with a gap where no frame came for a while", () => {
  const trace = new ForceTrace(4);
  for (const time of [10, 10.5, 12, 12.5]) trace.push(time, time, 2 * time);
  const kept = [3, 2, 1, 0].map((back) => trace.rawForces[trace.place(back)]);
  assert.deepEqual(kept, [10.5, NaN, 12, 12.5]);
  assert.deepEqual([9, 10.6, 12, 13].map((time) => backAt(trace, time)), [4, 3, 3, 0]);
});

/** A grid of 1 x 3, and its frame. */
const ROW = new Plane({
  shape: [1, 3], positions_mm: [[0, 0], [1, 0], [2, 0]], pitch_mm: 1, aperture: "square", aperture_mm: 1, raw: { rows: 1, columns: 3 },
  restored: { rows: 1, columns: 3, cell_mm: 1, origin_mm: [0, 0], mask: null }, areas_mm2: null,
});
const frameOf = (timestamp, raw) => ({
  timestamp, sequence: timestamp, raw: Float32Array.from(raw), restored: Float32Array.from(raw, (each) => 2 * each), unit: 0,
  noise: 0.1, noiseGain: 1, ofRaw: measures(), ofRestored: measures(), flags: new Uint8Array(3),
});

test("the highest of each cell is held since a frame, the mean over the last seconds; what is unknown is neither", () => {
  const held = new HeldImage();
  const frames = [frameOf(1, [5, NaN, 1]), frameOf(2, [3, 4, NaN]), frameOf(3, [1, 2, 3])];
  const history = { at: (back) => frames[frames.length - 1 - back] ?? null };
  const of = () => held.of(frames[2], history, 0, ROW, true);
  assert.equal(of(), frames[2]);
  held.reset("peak");
  for (const each of frames) held.push(each, ROW);
  assert.deepEqual([...of().raw, of().ofRestored.peak, held.since], [5, 4, 3, 10, 1]);
  assert.deepEqual([of().ofRaw.force, of().ofRestored.force, of().ofRestored.x], [NaN, NaN, NaN]); // of no moment
  held.reset("1");
  assert.deepEqual([...of().raw], [1, 2, 3]);
  held.reset("5");
  assert.deepEqual([...of().raw], [3, 3, 2]);
  assert.deepEqual([...mean([Float32Array.of(NaN, 1)], new Float32Array(0))], [NaN, 1]);
});

test("a report has the values of its frame, and takes no name for HTML", () => {
  const frame = frameOf(1, [5, 4, 30]);
  Object.assign(frame.ofRestored, { force: 0.078, peak: 60, x: 1.9, y: 0 });
  const trace = new ForceTrace(4);
  trace.push(1, 0.039, 0.078);
  const html = reportHtml({
    title: "palm <b>", frame, plane: ROW, origin: [["sensor", "a&b"]], pictures: [{ title: "Maps", address: "data:,", key: [] }, { title: "Pressure", address: "data:,", key: [{ name: "<i>raw, kPa", color: "#a35200", dash: "8,4", isBand: false }, { name: "± 2 s.d., kPa", color: "#0b62a8", dash: "", isBand: true }] }], contacts: [],
    regions: [["<i>heel", { force: 0.06, mean: 60, peak: 60, area: 1 }], ["toe", null]], trace, colors: { text: "#eee", muted: "#999", panel: "#111" },
  });
  for (const text of ["palm &#60;b&#62;", "a&#38;b", "<td>0.0780</td>", "<td>60.0</td>", "<td>3.00</td>", "&#60;i&#62;heel", "1.000,0.039,0.078", "<td>–</td>", '<path d="M0 6H28" stroke="#a35200" stroke-dasharray="8,4" stroke-width="3"/></svg>&#60;i&#62;raw, kPa</li><li>', "± 2 s.d., kPa</li></ul>", "color: #eee; background: #111;"]) assert.ok(html.includes(text), text);
  assert.ok(!/<b>|<i>|https?:/.test(html));
});
