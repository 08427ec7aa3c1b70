/** Values of the frames that are kept, over the last seconds. @module */

import { Chart, line } from "./chart.js";
import { steadyTop, roundUp } from "./display_range.js";

/** @import { Axes, Line } from "./chart.js" */
/** @import { FrameHistory } from "./frame_history.js" */

const SPAN_S = 10;

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
    /** @type {Axes} */
    this._axes = { left: -SPAN_S, right: 0, bottom: 0, top: 1, x: "time, s", y: unit };
    this._highest = 0;
    this._lowest = 0;
  }

  /** Another unit. @param {string} unit @param {number} minTop that the axis always reaches */
  measure(unit, minTop) {
    if (unit === this._axes.y) return;
    this._axes.y = unit;
    this._axes.top = 0;
    this._minTop = minTop;
  }

  /**
   * @param {FrameHistory} history
   * @param {["raw"|"restored"|"accent", Float64Array][]} rings the history's that are drawn, each with its ink
   */
  use(history, rings) {
    this._lines = rings.map(([ink, y]) => ({ ...line(0, ink), x: history.times, y }));
    this._axes.top = 0;
  }

  /** @param {FrameHistory} history @param {number} back which frame is shown */
  draw(history, back) {
    const { times } = history;
    const count = this._scan(history);
    const newest = history.place(0);
    for (let k = 0; k < this._lines.length; k += 1) {
      const each = this._lines[k];
      each.length = count;
      each.first = history.place(count - 1);
      each.zero = times[newest];
    }
    const { top } = this._axes;
    this._axes.top = steadyTop(top, this._highest);
    this._axes.bottom = this._lowest < -0.05 * this._axes.top ? -roundUp(-this._lowest) : -0.06 * this._axes.top;
    this.chart.draw(this._axes, this._lines, back ? times[history.place(back)] - times[newest] : NaN);
  }

  /**
   * Look for the extremes of the last seconds.
   * @param {FrameHistory} history
   * @returns {number} how many frames that is
   */
  _scan(history) {
    const { times, capacity, length } = history;
    const lines = this._lines;
    let at = history.place(0);
    const since = times[at] - SPAN_S;
    let highest = this._minTop; // in variables of its own: a number in a field may be an object y change
    let lowest = 0;
    let count = 0;
    while (count < length && times[at] >= since) {
      for (let k = 0; k < lines.length; k += 1) {
        const value = lines[k].y[at];
        if (value > highest) highest = value;
        if (value < lowest) lowest = value;
      }
      count += 1;
      at = at ? at - 1 : capacity - 1;
    }
    this._highest = highest;
    this._lowest = lowest;
    return count;
  }
}
