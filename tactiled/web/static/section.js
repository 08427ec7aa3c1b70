/**
 * The cross-section: pressure along a horizontal line, raw and restored.
 * @module
 */

import { Chart, line } from "./chart.js";
import { fixed } from "./paint.js";

/** @typedef {import("./plane.js").Plane} Plane */
/** @typedef {import("./plane.js").Cells} Cells */
/** @typedef {import("./history.js").Frame} Frame */
/** @typedef {import("./scale.js").Scale} Scale */
/** @typedef {import("./chart.js").Line} Line */

const SPREAD = 2; // standard deviations to either side of the restored line
const MARGIN = 0.06; // of the range, drawn below it
const DEEP = 0.4; // of the range, drawn below it while something is there
const HOLD = 180; // frames for which that stays, so that the axis does not jump

export class Section {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.chart = new Chart(canvas);
    /** @type {Plane|null} */
    this._plane = null;
    this._deep = 0; // frames for which the axis still reaches deep
    this._raw = line(0, "raw");
    this._restored = line(0, "restored");
    this._lines = [this._raw, this._restored];
    this._deviation = line(0, "restored"); // along the same cells
    /** @type {import("./chart.js").Axes} */
    this._axes = { left: 0, right: 1, bottom: 0, top: 1, x: "x, mm", y: "kPa" };
  }

  /** @param {Plane} plane */
  use(plane) {
    this._plane = plane;
    const style = plane.isGrid ? "steps" : "dots";
    this._raw = line(plane.raw.columns, "raw", style);
    this._restored = line(plane.restored.columns, "restored", style);
    this._lines = [this._raw, this._restored];
    this._deviation = line(plane.restored.columns, "restored");
    this._axes.left = plane.left;
    this._axes.right = plane.left + plane.width;
  }

  /**
   * @param {Frame|null} frame
   * @param {number} y mm, height of the line
   * @param {number} probeX mm; NaN for none
   * @param {Scale} scale
   * @param {Float32Array|null} deviation kPa, of each restored cell; null where it is not known
   */
  draw(frame, y, probeX, scale, deviation) {
    const plane = this._plane;
    if (!plane) return;
    const span = scale.high - scale.low;
    this._axes.top = scale.high;
    this._raw.length = this._restored.length = 0;
    if (frame) {
      cut(plane, plane.raw, frame.raw, y, this._raw);
      cut(plane, plane.restored, frame.restored, y, this._restored);
    }
    this._restored.spread = frame && deviation ? this._spread(plane, deviation, y) : null;
    const least = scale.low - MARGIN * span;
    this._deep = goesBelow(this._raw, least) || goesBelow(this._restored, least) ? HOLD : Math.max(0, this._deep - 1);
    this._axes.bottom = scale.low - (this._deep ? DEEP : MARGIN) * span;
    this.chart.draw(this._axes, this._lines, probeX, Number.isFinite(probeX) ? `x ${fixed(probeX, 1)} mm` : "");
  }

  /**
   * @param {Plane} plane
   * @param {Float32Array} deviation
   * @param {number} y mm
   * @returns {Float64Array} kPa, half the height of the band
   */
  _spread(plane, deviation, y) {
    cut(plane, plane.restored, deviation, y, this._deviation);
    for (let i = 0; i < this._deviation.length; i += 1) this._deviation.y[i] *= SPREAD;
    return this._deviation.y;
  }
}

/**
 * @param {Line} of
 * @param {number} least
 * @returns {boolean} some point is below
 */
function goesBelow(of, least) {
  for (let i = 0; i < of.length; i += 1) if (of.y[i] < least) return true;
  return false;
}

/**
 * The largest pressure along a horizontal line.
 * @param {Plane} plane
 * @param {number} y mm
 * @param {Float32Array} kpa of the restored image
 * @returns {number} kPa
 */
export function highest(plane, y, kpa) {
  const cells = plane.restored;
  const reach = (plane.isGrid ? cells.side : plane.pitch) / 2;
  let most = -Infinity;
  for (let i = 0; i < cells.count; i += 1) {
    if (kpa[i] > most && Math.abs(cells.y[i] - y) <= reach) most = kpa[i];
  }
  return most;
}

/**
 * @param {Plane} plane
 * @param {Cells} cells
 * @param {Float32Array} kpa
 * @param {number} y mm
 * @param {Line} into
 */
function cut(plane, cells, kpa, y, into) {
  let n = 0;
  if (plane.isGrid) {
    const row = Math.max(0, Math.min(cells.rows - 1, Math.floor((y - plane.top) / cells.side)));
    const first = row * cells.columns;
    for (; n < cells.columns; n += 1) {
      into.x[n] = cells.x[first + n];
      into.y[n] = kpa[first + n];
    }
  } else {
    for (const i of plane.order) {
      if (Math.abs(cells.y[i] - y) > plane.pitch / 2) continue;
      into.x[n] = cells.x[i];
      into.y[n] = kpa[i];
      n += 1;
    }
  }
  into.length = n;
}
