import assert from "node:assert/strict";
import test from "node:test";

import { Plane } from "../../tactiled/web/static/maps/geometry.js";
import { ON_COVER, SENSED, ShearArrows } from "../../tactiled/web/static/maps/shear_arrows.js";

globalThis.window = { devicePixelRatio: 2 };

/** Stands for a canvas, and for the context that notes what is drawn on it. */
function fakeCanvas() {
  const calls = [];
  const noted = { get: (to, name) => to[name] ?? ((...of) => calls.push([name, ...of])) };
  return { calls, style: {}, getContext: () => new Proxy({}, noted) };
}

const plane = new Plane({
  shape: [1, 3], positions_mm: [[0, 0], [10, 0], [20, 0]], pitch_mm: 10, aperture: "square", aperture_mm: 10,
  raw: { rows: 1, columns: 3 }, restored: { rows: 1, columns: 3, cell_mm: 10, origin_mm: [0, 0], mask: null }, areas_mm2: null,
});

/** Draws arrows at a zoom, CSS px per mm: middle and vector of each, CSS px, and what the key says. */
function drawer(zoom = 5, of = SENSED) {
  const canvas = fakeCanvas();
  const key = { canvas: fakeCanvas(), span: {}, querySelector: (name) => key[name] };
  const arrows = new ShearArrows(canvas, key, of);
  arrows.resize(plane, zoom);
  return (x, y, time = 0) => {
    canvas.calls.length = 0;
    arrows.draw(Float32Array.from([...x, ...y]), time);
    const points = canvas.calls.filter(([name]) => name.endsWith("To")).map(([,
      ...of]) => of.map((each) => each / 32));
    const shafts = points.filter((_, i) => i % 5 < 2);
    return [key.span.textContent, Array.from({ length: shafts.length / 2 }, (_, i) => {
      const [[x0, y0], [x1, y1]] = [shafts[2 * i], shafts[2 * i + 1]];
      return [(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0].map(Math.round);
    })];
  };
}

test("an arrow stands about its taxel in the direction of the shear, to the scale of the key", () => {
  assert.deepEqual(drawer()([1000, 0, -600], [0, -500, 600]), [
    "1000 counts", [[25, 25, 24, 0], [75, 25, 0, -12], [125, 25, -14, 14]],
  ]);
});

test("a taxel without data or hardly any shear has none, and noise is not drawn large", () => {
  assert.deepEqual(drawer()([NaN, 3, 0], [NaN, 0, 3]), ["50 counts", []]);
});

test("the scale holds still while the shear fills it well", () => {
  const draw = drawer();
  for (const [i, counts] of [480, 400, 470, 430].entries()) {
    assert.deepEqual(draw([counts, 0, 0], [0, 0, 0], i / 50), [
      "500 counts", [[25, 25, Math.round(24 * counts / 500), 0]],
    ]);
  }
});

/** Numbers of a normal distribution, the same every time. */
function* normal() {
  for (let seed = 1; ;) {
    const uniform = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
    yield Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform());
  }
}

test("what is within three deviations of the noise has no arrow, and the scale stays above it", () => {
  const noise = normal();
  const deviation = 300; // counts, x and y together
  const some = () => (noise.next().value * deviation) / Math.SQRT2;
  const draw = drawer(15);
  let arrows = 0;
  let key = "";
  for (let i = 0; i < 400; i += 1) {
    const [text, drawn] = draw([some(), some(), some()], [some(), some(), some()], i / 50);
    if (i >= 100) arrows += drawn.length;
    key = text;
  }
  assert.ok(arrows < 10, `${arrows} of 900`);
  assert.ok(parseFloat(key) >= 10 * deviation, key);
  const [, drawn] = draw([2000 + some(), some(), some()], [some(), some(), some()], 8);
  assert.equal(drawn.length, 1);
});

test("restored shear is in kPa, and thinned where its cells are near one another; before a tare it has no key", () => {
  const draw = drawer(1, ON_COVER); // cells of 10 px: every other one
  const nothing = [NaN, NaN, NaN];
  assert.deepEqual(draw(nothing, nothing), [undefined, []]);
  assert.deepEqual(draw([1, 1, 1], [0, 0, 0], 1), ["1 kPa", [[5, 5, 14, 0], [25, 5, 14, 0]]]);
  assert.deepEqual(drawer(5, ON_COVER)([0, 2, 0], [0, 0, 0]), ["2 kPa", [[75, 25, 24, 0]]]);
});
