/** Values over the last seconds. @module */

import { Chart, line } from "./chart.js";
import { roundUp, steadyTop } from "../maps/display_range.js";

/** @import { Axes, Line } from "./chart.js" */

const MAX_POINTS = 2304; // of a line: of more, the lowest and the highest of each piece are drawn

/**
 * Values in rings, as of a FrameHistory or ForceTrace.
 * @typedef {object} Rings
 * @property {Float64Array} times Unix s, rising
 * @property {number} length values in use
 * @property {(back: number) => number} place of a value, counted back from the newest
 */

export class TrendChart {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {string} unit
   * @param {number} minTop that the axis always reaches
   */
  constructor(canvas, unit, minTop) {
    this.chart = new Chart(canvas);
    this._minTop = minTop;
    /** @type {Line[]} */
    this._lines = [];
    /** @type {Float64Array[]} that they are drawn of */
    this._values = [];
    /** @type {Axes} */
    this._axes = { left: 0, right: 0, bottom: 0, top: 1, x: "time, s", y: unit };
  }

  /** Another unit. @param {string} unit @param {number} minTop that the axis always reaches */
  measure(unit, minTop) {
    if (unit === this._axes.y) return;
    this._axes.y = unit;
    this._axes.top = 0;
    this._minTop = minTop;
  }

  /** @param {["raw"|"restored"|"accent", Float64Array][]} rings that are drawn, each with its ink */
  use(rings) {
    this._lines = rings.map(([ink]) => line(MAX_POINTS + 3, ink));
    this._values = rings.map(([, values]) => values);
    this._axes.top = 0;
  }

  /**
   * @param {Rings} rings with the times of the values
   * @param {[number, number]} ends of the axis, s from the newest
   * @param {number} cursor Unix s, of the frame that is shown; NaN for none
   */
  draw(rings, [left, right], cursor) {
    const { _axes: axes } = this;
    const newest = rings.times[rings.place(0)];
    const first = backAt(rings, newest + left);
    const last = backAt(rings, newest + right);
    let highest = this._minTop;
    let lowest = 0;
    for (let k = 0; k < this._lines.length; k += 1) {
      const of = this._lines[k];
      of.zero = newest;
      fill(of, rings, this._values[k], Math.min(rings.length - 1, first), Math.max(0, last - 1));
      highest = Math.max(highest, highestOf(of));
      lowest = Math.min(lowest, lowestOf(of));
    }
    axes.left = left;
    axes.right = right;
    axes.top = steadyTop(axes.top, highest);
    axes.bottom = lowest < -0.05 * axes.top ? -roundUp(-lowest) : -0.06 * axes.top;
    this.chart.draw(axes, this._lines, cursor - newest);
  }
}

/** @param {Rings} rings @param {number} time Unix s @returns {number} how far back the newest value is that is older; `length` for none */
export function backAt(rings, time) {
  let [low, high] = [0, rings.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rings.times[rings.place(middle)] < time) high = middle;
    else low = middle + 1;
  }
  return low;
}

/**
 * @param {Line} into
 * @param {Rings} rings
 * @param {Float64Array} values
 * @param {number} first how far back the oldest of them is
 * @param {number} last the newest
 */
function fill(into, rings, values, first, last) {
  const { times } = rings;
  const { x, y } = into;
  const count = rings.length ? first - last + 1 : 0;
  const step = Math.max(1, Math.ceil((3 * count) / MAX_POINTS));
  let length = 0;
  for (let back = first; back >= last && count > 0; back -= step) {
    let low = rings.place(back);
    let high = low;
    let gap = Number.isNaN(values[low]);
    for (let b = back - 1; b >= Math.max(last, back - step + 1); b -= 1) {
      const at = rings.place(b);
      if (Number.isNaN(values[at])) gap = true;
      if (values[at] < values[low] || Number.isNaN(values[low])) low = at;
      if (values[at] > values[high] || Number.isNaN(values[high])) high = at;
    }
    const one = times[low] <= times[high] ? low : high;
    const other = one === low ? high : low;
    x[length] = times[one];
    y[length++] = values[one];
    if (other !== one) {
      x[length] = times[other];
      y[length++] = values[other];
    }
    if (gap) {
      x[length] = times[other];
      y[length++] = NaN;
    }
  }
  into.length = length;
}

// Functions of their own, which browsers compile sooner than what calls them: every value read before is an object.
/** @param {Line} of @returns {number} */
function highestOf({ y, length }) {
  let highest = -Infinity;
  for (let i = 0; i < length; i += 1) if (y[i] > highest) highest = y[i];
  return highest;
}

/** @param {Line} of @returns {number} */
function lowestOf({ y, length }) {
  let lowest = Infinity;
  for (let i = 0; i < length; i += 1) if (y[i] < lowest) lowest = y[i];
  return lowest;
}
