import assert from "node:assert/strict";
import test from "node:test";

import { line } from "../../tactiled/web/static/charts/chart.js";
import { highestAlong, sample } from "../../tactiled/web/static/charts/cross_section.js";
import { ContactOutline } from "../../tactiled/web/static/maps/contact_outline.js";
import { Plane } from "../../tactiled/web/static/maps/geometry.js";
import { FrameHistory } from "../../tactiled/web/static/wire/frame_history.js";
import { measure, measures, rawMayLack, restoredMayLack } from "../../tactiled/web/static/maps/measures.js";
import { placeNames } from "../../tactiled/web/static/maps/region_layer.js";
import { cellsIn, measureRegion } from "../../tactiled/web/static/maps/region_measure.js";

/** A grid at a pitch of 2 mm, restored at the same cells. */
function grid(rows, columns) {
  const positions_mm = Array.from({ length: rows * columns }, (_, i) => [2 * (i % columns),
    2 * Math.floor(i / columns)]);
  return new Plane({
    shape: [rows, columns], positions_mm, pitch_mm: 2, aperture: "square", aperture_mm: 2, raw: { rows, columns },
    restored: { rows, columns, cell_mm: 2, origin_mm: [0, 0], mask: null }, areas_mm2: null,
  });
}

const CORNERS = [[0, 0], [3, 0], [1.5, 2], [4.5, 2.5]];
const MASK = [[true, true, true, false], [true, true, true, true], [false, true, true, true]];
const scattered = () => new Plane({
  shape: null, positions_mm: CORNERS, pitch_mm: 1.5, aperture: "round", aperture_mm: 1.5, raw: { rows: 1,
    columns: 4 },
  restored: { rows: 3, columns: 4, cell_mm: 1.5, origin_mm: [0, -0.25], mask: MASK }, areas_mm2: [1, 2, 3, 4],
});

test("a plane is as large as its restored image", () => {
  const { left, top, width, height } = grid(2, 3);
  assert.deepEqual([left, top, width, height], [-1, -1, 6, 4]);
  const other = scattered();
  assert.deepEqual([other.left, other.top, other.width, other.height], [-0.75, -1, 6, 4.5]);
});

test("a place belongs to the cell around it, and to none off the array", () => {
  const plane = grid(2, 3);
  assert.equal(plane.find(plane.raw, 0.9, 0.9), 0);
  assert.equal(plane.find(plane.raw, 4, 2), 5);
  for (const [x, y] of [[-1.1, 0], [5.1, 0], [0, -1.1], [0, 3.1]]) assert.equal(plane.find(plane.raw, x, y), -1);
  const other = scattered();
  assert.equal(other.find(other.raw, 3.5, 0.5), 1);
  assert.equal(other.find(other.raw, 0, 2.5), -1);
  assert.deepEqual([[0, 0], [1.6, 1.4], [4.5, 0], [0, 3]].map(([x, y]) => other.find(other.restored, x, y)), [0, 5, -1, -1]);
});

test("a cross-section runs along y at first where the array is more than twice as tall as wide", () => {
  assert.deepEqual([grid(12, 2).along, grid(4, 2).along, grid(2, 12).along], ["y", "x", "x"]);
});

/** The points of a cross-section. */
function points(plane, kpa, along, lineAt) {
  const into = line(plane.raw.count, "raw");
  sample(plane, plane.raw, Float32Array.from(kpa), { along, lineAt }, into);
  return [Array.from(into.x.slice(0, into.length)), Array.from(into.y.slice(0, into.length))];
}

test("a cross-section takes the cells of its row or column, at the edge the last", () => {
  const plane = grid(2, 3);
  const kpa = [1, 2, 3, 4, 5, 6];
  assert.deepEqual(points(plane, kpa, "x", 0), [[0, 2, 4], [1, 2, 3]]);
  assert.deepEqual(points(plane, kpa, "x", 3), [[0, 2, 4], [4, 5, 6]]);
  assert.deepEqual(points(plane, kpa, "y", 2), [[0, 2], [2, 5]]);
  assert.equal(highestAlong(plane, { along: "y", lineAt: 4 }, kpa), 6);
});

test("on a layout that is no grid it takes the taxels within half a pitch, in their order", () => {
  const plane = scattered();
  assert.deepEqual(points(plane, [1, 2, 3, 4], "x", 2.4), [[1.5, 4.5], [3, 4]]);
  assert.deepEqual(points(plane, [1, 2, 3, 4], "y", 4.4), [[2.5], [4]]);
  assert.equal(highestAlong(plane, { along: "x", lineAt: 0 }, [1, 2, 3, NaN, 9, 9, 9, 9, NaN, 9, 9, 9]), 3);
});

test("force, peak and centre leave out taxels without data, and noise is no contact", () => {
  const plane = grid(2, 3);
  const image = measures();
  const some = rawMayLack(plane.raw);
  measure(Float32Array.from([NaN, 0, 10, 0, 0, 30]), plane.raw, 0.5, image, 0, some);
  assert.deepEqual([image.force, image.peak, image.peakIndex, image.unknown], [0.16, 30, 5, 1]);
  assert.deepEqual([image.contact, image.x, image.y, image.peakX, image.peakY], [true, 4, 1.5, 4, 2]);
  measure(Float32Array.from([0, 0, 10, 0, 0, 30]), plane.raw, 7, image);
  assert.deepEqual([image.contact, image.x, image.peakX], [false, NaN, NaN]);
  measure(new Float32Array(6).fill(NaN), plane.raw, 0, image);
  assert.deepEqual([image.force, image.peak, image.peakIndex], [NaN, NaN, -1]);
  measure(Float32Array.from([NaN, 0, 10, NaN, 0, 30]), plane.raw, 0.5, image, 0, some);  // a third is unknown
  assert.deepEqual([image.force, image.peak, image.contact, image.unknown, image.highest], [NaN, NaN, false, 2, 30]);
  measure(Float32Array.from([1, 1, 1, 1]), scattered().raw, 0, image);
  assert.equal(image.force, 0.01);
  measure(Float32Array.from(MASK.flat(), (felt) => (felt ? 2 : NaN)), scattered().restored, 0, image);
  assert.deepEqual([image.force, image.unknown], [0.045, 0]); // of ten cells: the other two feel nothing
});

test("of a restored image nothing is known where a cell is unknown, or too many taxels are lost", () => {
  const plane = grid(2, 3);
  const image = measures();
  for (const [first, flags, known] of [[NaN, [1, 0, 0, 0, 0, 0], false], [0, [1, 0, 0, 0, 0, 0], true], [0, [1, 64, 0, 0, 0, 0], false], [0, [4, 4, 0, 0, 0, 0], true]]) {
    measure(Float32Array.from([first, 0, 10, 0, 0, 30]), plane.restored, 0.5, image, 0, restoredMayLack(Uint8Array.from(flags)));
    assert.deepEqual([image.force, image.peak, image.highest], known ? [0.16, 30, 30] : [NaN, NaN, 30]);
  }
});

test("a raw image has no force where the restored one is unknown: a load may be on the taxels that did not come", () => {
  const history = new FrameHistory(grid(2, 3), [0, 1]);
  const force = (first, flags) => {
    const of = { unit: 0, sequence: 1, timestamp: 1, noise: 0.5, noiseGain: 1, method: 0 };
    const images = [[NaN, 0, 10, 0, 0, 30], [first, 0, 10, 0, 0, 30]].map((values) => ({ ...of, values: Float32Array.from(values), flags }));
    return history.push(images, [0, 1]).ofRaw.force;
  };
  assert.deepEqual([force(NaN, [1, 0, 0, 0, 0, 0]), force(0, [2, 0, 0, 0, 0, 0])], [NaN, 0.16]);
});

test("outlines are of the frame that is shown, wherever its contacts were found", () => {
  const plane = grid(6, 10);
  const outline = new ContactOutline();
  const frame = (sequence, pressed) => ({
    sequence, noise: 0.5, noiseGain: 1, restored: Float32Array.from({ length: 60 }, (_, i) => (pressed.includes(i) ? 40 : 0)),
  });
  const contact = { id: 3, x_mm: 3, y_mm: 3, peak: 40, major_mm: 1, minor_mm: 1, angle_rad: 0 };
  const contacts = [contact, { ...contact, id: 4, x_mm: 18, y_mm: 10 }];
  outline.update(frame(7, [11, 12, 21, 22]), plane, contacts);
  assert.deepEqual([...outline.extents.subarray(0, 4)], [1, 1, 3, 3]);
  assert.deepEqual([[...outline.cells], [...outline.centres.subarray(0, 2)]], [[4, 0], [3, 3]]);
  outline.update(frame(8, [12, 13, 14, 15, 16]), plane, contacts);
  assert.deepEqual([...outline.extents.subarray(0, 4)], [2, 1, 7, 2]);
  assert.deepEqual([[...outline.cells], [...outline.centres.subarray(0, 2)]], [[5, 0], [8, 2]]);
  const besideHole = frame(9, [12, 13, 14, 15, 16]);
  besideHole.restored[17] = NaN;
  outline.update(besideHole, plane, contacts);
  assert.deepEqual([...outline.cells], [1, 0]); // what reaches the hole is no contact's
  outline.update(frame(10, []), plane, contacts);
  assert.deepEqual([outline.count, ...outline.cells], [0, 0, 0]);
});

test("a region holds what the frame that is shown has in it, and nothing is known of one with holes", () => {
  const { restored: cells } = grid(4, 5);
  const frame = { noise: 1, noiseGain: 1, unit: 0, restored: Float32Array.from({ length: 20 }, (_, i) => i) };
  const rectangle = cellsIn({ shape: "rectangle", points_mm: [[3, 5], [-1, 1]] }, cells);
  assert.deepEqual(rectangle, [5, 6, 10, 11]);
  assert.deepEqual(measureRegion(rectangle, frame, cells), { force: 4 * 32e-3, mean: 8, peak: 11, area: 16 });
  assert.deepEqual(measureRegion(rectangle, { ...frame, highest: true }, cells), { force: NaN, mean: NaN, peak: 11, area: NaN });
  assert.deepEqual(cellsIn({ shape: "ellipse", points_mm: [[1, 1], [7, 5]] }, cells), [6, 7, 8, 11, 12, 13]);
  assert.deepEqual(cellsIn({ shape: "polygon", points_mm: [[-1, -1], [5, -1], [-1, 5]] }, cells), [0, 1, 5]);
  assert.deepEqual(cellsIn({ shape: "rectangle", points_mm: [[2.5, -1], [6, 2]] }, scattered().restored), [2, 6, 7]);
  frame.restored[5] = NaN;
  assert.equal(measureRegion(rectangle, frame, cells), null);
});

test("a ring in two halves has its own cells alone, not the bead in its middle or one that is no contact", () => {
  const plane = grid(13, 13);
  const { x, y, area } = plane.restored;
  const far = (i) => Math.hypot(x[i] - x[84], y[i] - y[84]) / plane.pitch; // from the middle
  const cells = [...x.keys()];
  const ring = cells.filter((i) => Math.abs(far(i) - 4) < 0.6);
  const halves = [ring.filter((i) => x[i] < x[84]), ring.filter((i) => x[i] >= x[84])];
  const spread = (of, at) => Math.sqrt(of.reduce((sum, i) => sum + (at[i] - centre(of, at)) ** 2, 0) / of.length + 0.3);
  const centre = (of, at) => of.reduce((sum, i) => sum + at[i], 0) / of.length;
  const contact = (of, n) => ({
    id: n, x_mm: centre(of, x), y_mm: centre(of, y), peak: 50, force: 0.05 * area[0] * of.length,
    major_mm: spread(of, y), minor_mm: spread(of, x), angle_rad: Math.PI / 2,
  });
  const bead = [84];
  const restored = Float32Array.from(cells, (i) => (ring.includes(i) || i === 84 || i === 0 ? 50 : 0));
  const outline = new ContactOutline();
  outline.update({ sequence: 1, noise: 0.5, noiseGain: 1, restored }, plane, [...halves, bead].map(contact), 2);
  assert.deepEqual([...outline.cells], [halves[0].length, halves[1].length, 1]);
  assert.deepEqual([...outline.outlined], [1, 1, 0]);
});

test("names of regions stay on the map, touch what is no rectangle, and cover no other", () => {
  const name = (left, top, bottom, low, high) => ({ name: "heel", color: "", left, top, bottom, low, high });
  const places = placeNames([
    name(10, 20, 60), name(20, 20, 60), name(180, 150, 196), name(15, 10, 62), name(90, 100, 120, 100, 100), name(70, 80, 120, 110, 130),
  ], 200, 200, () => 40);
  assert.deepEqual(places.map(({ x, y }) => [x, y]), [[12, 73], [22, 16], [158, 146], [17, 58], [80, 133], [110, 76]]);
});
