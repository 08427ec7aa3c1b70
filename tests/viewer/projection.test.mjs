import assert from "node:assert/strict";
import test from "node:test";

import { Columns, Projection } from "../../tactiled/web/static/maps/projection.js";

const [ROWS, COLUMNS, SIDE] = [3, 4, 2];
const [WIDTH, HEIGHT] = [300, 220];
const PLANE = { left: -1, top: 3, width: COLUMNS * SIDE, height: ROWS * SIDE };
const CELLS = {
  rows: ROWS, columns: COLUMNS, count: ROWS * COLUMNS, side: SIDE,
  x: Array.from({ length: ROWS * COLUMNS }, (_, i) => -1 + SIDE * ((i % COLUMNS) + 0.5)),
  y: Array.from({ length: ROWS * COLUMNS }, (_, i) => 3 + SIDE * (Math.floor(i / COLUMNS) + 0.5)),
};
const VALUES = [3, 9, 1, 0, 4, -2, NaN, 7, 30, 5, 2, 8];
const RANGE = { low: 0, high: 10 };
const TURNS = [[0, 35], [-30, 35], [45, 20], [90, 10], [100, 60], [180, 35], [-135, 80], [-90, 45], [20, 90]];

function seenFrom(azimuth, elevation) {
  const projection = new Projection();
  projection.fit(PLANE, WIDTH, HEIGHT);
  projection.turn(projection.azimuth - azimuth, elevation - projection.elevation);
  return projection;
}

/** The picture: of each pixel 1 + the cell that it shows, 0 for none. */
function painted(projection, ratio = 1) {
  const columns = new Columns(CELLS);
  columns.aim(projection, ratio);
  const pixels = new Uint32Array(WIDTH * HEIGHT * ratio * ratio);
  const numbers = Uint32Array.from(VALUES, (_, i) => i + 1);
  const index = (/** @type {number} */ value) => VALUES.findIndex((each) => Object.is(each, value));
  columns.paint(pixels, WIDTH * ratio, Float32Array.from(VALUES), RANGE, { rgba: numbers, index }, [numbers, numbers]);
  return pixels;
}

/** What a ray through a pixel meets first, from the range's top downwards. */
function met(projection, left, top) {
  const { cos, sin, flat, px, rise } = projection;
  const u = (left - projection.left(0, 0)) / px;
  for (let share = 1; share > 0; share -= 0.005) {
    const v = (top + share * rise - projection.top(0, 0, 0)) / (px * flat);
    const column = Math.floor((u * cos + v * sin - PLANE.left) / SIDE);
    const row = Math.floor((v * cos - u * sin - PLANE.top) / SIDE);
    if (column < 0 || row < 0 || column >= COLUMNS || row >= ROWS) continue;
    const at = row * COLUMNS + column;
    if (Math.max(0.005, Math.min(1, VALUES[at] / RANGE.high)) >= share - 1e-9) return at + 1;
  }
  return 0;
}

test("of columns, holes and what is beyond the range, each pixel shows what is nearest to the eye", () => {
  for (const [azimuth, elevation] of TURNS) {
    const projection = seenFrom(azimuth, elevation);
    const pixels = painted(projection);
    let [others, some] = [0, 0];
    for (let i = 0; i < pixels.length; i += 1) {
      const expected = met(projection, (i % WIDTH) + 0.5, Math.floor(i / WIDTH) + 0.5);
      some += expected > 0;
      others += pixels[i] !== expected;
    }
    assert.ok(some > 4000 && others < 0.02 * some, `${azimuth}, ${elevation}: ${others} of ${some} pixels`);
  }
});

test("seen from above it is the flat map, with a hole where nothing is known", () => {
  const projection = seenFrom(0, 90);
  const pixels = painted(projection, 2);
  VALUES.forEach((value, i) => {
    const [x, y] = [projection.left(CELLS.x[i], CELLS.y[i]), projection.top(CELLS.x[i], CELLS.y[i], 0)];
    assert.equal(pixels[Math.floor(2 * y) * 2 * WIDTH + Math.floor(2 * x)], Number.isNaN(value) ? 0 : i + 1);
  });
});

test("however it is turned it stays in its box, nearer places lower, and comes back", () => {
  const projection = seenFrom(-30, 35);
  for (let i = 0; i < 60; i += 1) {
    projection.turn(25, i % 3 ? 20 : -60);
    assert.ok(Math.abs(projection.azimuth) <= 180 && projection.elevation >= 10 && projection.elevation <= 90);
    for (const [x, y] of [[-1, 3], [7, 3], [-1, 9], [7, 9]]) {
      const [left, foot, top] = [projection.left(x, y), projection.top(x, y, 0), projection.top(x, y, 1)];
      assert.ok(left > 30 && left < WIDTH - 30 && foot < HEIGHT - 20 && top <= foot && top > 20);
    }
  }
  projection.reset();
  assert.deepEqual([projection.azimuth, projection.elevation], [-30, 35]);
  assert.ok(projection.top(-1, 9, 0) > projection.top(7, 3, 0) && projection.left(7, 9) > projection.left(-1, 9));
});
