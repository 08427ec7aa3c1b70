import assert from "node:assert/strict";
import test from "node:test";

import { gappedLine } from "../../tactiled/web/static/chart.js";
import { ContactSeries } from "../../tactiled/web/static/contact_series.js";
import { seriesCsv } from "../../tactiled/web/static/export_csv.js";
import { Plane, cellAround } from "../../tactiled/web/static/geometry.js";

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
    raw: { rows: 2, columns: 3 }, restored: { rows: 4, columns: 6, cell_mm: 1 },
  });
  assert.deepEqual(cellAround(plane, [[0.1, 0.9], [0.4, 0.6]]), { name: "cell r1 c1", corners: [[0, 0], [1, 1]] });
  assert.equal(cellAround(plane, [[0.1, 0.9], [0.1, 1.1]]), null);
  assert.equal(cellAround(plane, [[-5, 0], [-5, 0]]), null);
});
