import assert from "node:assert/strict";
import test from "node:test";

import { inkOn } from "../../tactiled/web/static/maps/cell_values.js";
import { DisplayRange } from "../../tactiled/web/static/maps/display_range.js";
import { byteText, duration, fixed, newtons, number, whole } from "../../tactiled/web/static/shell/format.js";
import { decadeTicks, endsAndTicks, tickText, ticks } from "../../tactiled/web/static/charts/ticks.js";

const check = (convert, table) => {
  for (const [value, text] of table) assert.equal(convert(value), text, `${value}`);
};

test("a force has three digits", () => {
  check(newtons, [
    [0, "0.00"], [1e-9, "0.000"], [-1e-9, "0.000"], [0.00123456, "0.00123"], [-0.00456, "−0.00456"], [0.000943, "0.00094"],
    [0.009999, "0.0100"], [0.09994, "0.0999"], [0.09996, "0.100"], [0.12345, "0.123"], [12.345, "12.3"], [-1.234,
      "−1.23"],
    [NaN, "–"],
  ]);
});

test("numbers have a true minus sign, no minus zero, and a dash without a value", () => {
  check((value) => fixed(value, 1), [[-0.04, "0.0"], [-0.06, "−0.1"], [Infinity, "–"], [3, "3.0"]]);
  check(number, [[0, "0.00"], [123.4, "123"], [-1.234, "−1.23"], [0.7, "0.700"], [0.0123, "0.0123"], [0.079, "0.0790"], [-0.0001, "0.000"],
    [99.94, "99.9"], [99.96, "100"], [9.996, "10.0"], [0.9994, "0.999"], [0.9996, "1.00"], [NaN, "–"]]);
});

test("a force in counts is whole, and short from a million on", () => {
  check(whole, [[-0.4, "0"], [999_999.4, "999999"], [999_999.5, "1.00e6"], [-10_098_311, "−1.01e7"], [Infinity, "–"]]);
});

test("a file's size is in whole bytes or three digits", () => {
  check(byteText, [[0, "0 B"], [999, "999 B"], [1500, "1.50 kB"], [12_340_000, "12.3 MB"], [5e12, "5000 GB"]]);
});

test("a duration is in seconds, minutes or hours", () => {
  check(duration, [[0.31, "0.3 s"], [99, "99.0 s"], [100, "1 min"], [5999, "99 min"], [7200, "2 h"]]);
});

test("ticks are round and in the range", () => {
  assert.deepEqual(ticks(0, 50, 5), [0, 10, 20, 30, 40, 50]);
  assert.deepEqual(ticks(-1, 1, 5), [-1, -0.5, 0, 0.5, 1]);
  assert.deepEqual(ticks(3, 11, 5), [4, 6, 8, 10]);
});

test("ticks are never more than requested, however odd the range", () => {
  for (const [low, high] of [[1, 1 + 2 ** -52], [2 ** 53, 2 ** 53 + 2], [-1e308, 1e308], [-1e-323, 1e-323]]) {
    assert.ok(ticks(low, high, 8).length <= 9);
  }
});

test("the legend has both its ends, and large and small numbers fit", () => {
  const texts = (low, high) => endsAndTicks(low, high, 8).map((each) => tickText(each, high - low));
  assert.deepEqual(texts(0, 150), ["0", "20", "40", "60", "80", "100", "120", "150"]);
  assert.equal(texts(0, 1234567).at(-1), "1.23e6");
  assert.deepEqual(texts(0, 1e-5).slice(0, 2), ["0", "2e−6"]);
  assert.equal(texts(-2, 10)[0], "−2");
  for (const all of [texts(0, 150), texts(0, 1234567), texts(0, 1e-5), texts(123000, 123500), texts(-2, 10)]) {
    assert.equal(new Set(all).size, all.length);
    assert.ok(all.every((each) => each.length <= 8));
  }
});

test("an axis of decades is labelled by powers of ten", () => {
  assert.deepEqual(decadeTicks(-4, 0).map((each) => each.text), ["10⁻⁴", "10⁻³", "10⁻²", "0.1", "1"]);
});

/** The top of an automatic range after each of these peaks, 50 a second. */
function tops(peaks) {
  const range = new DisplayRange();
  return peaks.map((peak, i) => {
    range.follow(peak, 0.5, i / 50);
    return range.high;
  });
}

test("an automatic range holds every peak and does not flicker", () => {
  const steady = Array.from({ length: 1500 }, (_, i) => 100 * (1 + 0.14 * Math.sin(7 * i) * Math.cos(i)));
  const highs = tops(steady);
  assert.ok(highs.every((high, i) => high >= steady[i]));
  assert.ok(highs.filter((high, i) => i > 50 && high !== highs[i - 1]).length <= 1);
  const rising = tops(Array.from({ length: 500 }, (_, i) => 1 + 2 * i));
  assert.ok(rising.every((high, i) => !i || high >= rising[i - 1]));
  const seconds = (to) => { // until the range holds a press that fell from 1000
    const highs = tops(Array.from({ length: 3510 }, (_, i) => (i < 10 ? 1000 : to)));
    return (highs.findIndex((high) => high <= 4 * to) - 9) / 50;
  };
  for (const to of [10, 99, 149, 190, 249]) assert.ok(seconds(to) < 0.25, `${to}`); // none stays in the lowest quarter
  const half = tops(Array.from({ length: 3510 }, (_, i) => (i < 10 ? 1000 : 400)));
  for (const [top, share] of [[800, 0.467], [600, 0.183], [500, 0.0417]]) { // a tenth of the distance a second
    assert.ok(Math.abs((half.indexOf(top) - 9) / 50 - 10 * Math.log(1 / share)) < 0.3, `${top}`);
  }
  const lifted = tops(Array.from({ length: 500 }, (_, i) => 10 * Math.max(0, Math.min(10, i % 50, 25 - (i % 50)))));
  assert.equal(new Set(lifted.slice(20)).size, 1); // presses that come and go do not flicker
});

test("a frame that is paused has a range of its own", () => {
  const range = new DisplayRange();
  range.follow(1000, 0.5, 0);
  range.show(33, 0.5);
  assert.equal(range.high, 40);
});

test("a fixed range stays until it is released", () => {
  const range = new DisplayRange();
  assert.equal(range.fix(10, 50), "");
  range.follow(2000, 0, 1);
  range.reset();
  assert.deepEqual([range.low, range.high, range.auto], [10, 50, false]);
  range.follow(90, 0, 2);
  range.release();
  assert.deepEqual([range.low, range.high, range.auto], [0, 100, true]);
});

test("a pair of numbers that is no range is refused with the reason and changes nothing", () => {
  const range = new DisplayRange();
  range.fix(0, 50);
  for (const [low, high, reason] of [
    [60, 50, /maximum must exceed/], [0, -1, /maximum must exceed/], [0, NaN, /missing/], [-1e308, 1e308,
      /too far apart/],
    [1, 1 + 2 ** -52, /too close/], [-49.9999999, -49.9999998, /too close/],
  ]) {
    assert.match(range.fix(low, high), reason);
    assert.deepEqual([range.low, range.high], [0, 50]);
  }
});

test("black or white is written on a colour, whichever contrasts more", () => {
  const contrast = (ink, level) => {
    const light = (each) => (each <= 10 ? each / 3294 : ((each / 255 + 0.055) / 1.055) ** 2.4);
    const [a, b] = [light(ink === "#fff" ? 255 : 0), light(level)].sort((one, other) => other - one);
    return (a + 0.05) / (b + 0.05);
  };
  for (let grey = 0; grey < 256; grey += 1) {
    const ink = inkOn(((255 << 24) | (grey << 16) | (grey << 8) | grey) >>> 0);
    assert.ok(contrast(ink, grey) > 4.4, `${grey}`);
  }
  assert.deepEqual([inkOn(0xff00ffff), inkOn(0xffff0000)], ["#000", "#fff"]); // yellow, blue
});
