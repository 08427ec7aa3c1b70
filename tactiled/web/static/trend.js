/**
 * Values of the frames that are kept, over the last seconds.
 * @module
 */

import { Chart, line } from "./chart.js";
import { roundUp } from "./scale.js";

/** @typedef {import("./history.js").History} History */
/** @typedef {import("./history.js").Frame} Frame */

/**
 * @typedef {object} Series
 * @property {"raw"|"restored"|"accent"} ink
 * @property {(frame: Frame, into: Float64Array, at: number) => void} put what is drawn of a frame; NaN for nothing.
 *   Written, not returned: a returned number would be an object for the collector, thousands of them a second
 */

const SPAN_S = 10;

export class Trend {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {string} unit
   * @param {number} least that the axis always reaches
   * @param {Series[]} series
   */
  constructor(canvas, unit, least, series) {
    this.chart = new Chart(canvas);
    this._series = series;
    this._least = least;
    this._lines = series.map((each) => line(0, each.ink));
    /** @type {import("./chart.js").Axes} */
    this._axes = { left: -SPAN_S, right: 0, bottom: 0, top: 1, x: "time, s", y: unit };
    this._most = 0;
    this._lowest = 0;
  }

  /** @param {History} history */
  use(history) {
    this._lines = this._series.map((each) => line(history.capacity, each.ink));
    this._axes.top = roundUp(this._least);
  }

  /**
   * @param {History} history
   * @param {number} back which frame is shown
   */
  draw(history, back) {
    this._collect(history);
    const top = roundUp(this._most);
    if (top > this._axes.top || roundUp(this._most / 0.85) < this._axes.top) this._axes.top = top;
    this._axes.bottom = this._lowest < -0.05 * top ? -roundUp(-this._lowest) : -0.06 * top;
    const newest = history.at(0);
    const shown = back ? history.at(back) : null;
    this.chart.draw(this._axes, this._lines, shown && newest ? shown.timestamp - newest.timestamp : NaN);
  }

  /** @param {History} history */
  _collect(history) {
    const newest = history.at(0);
    let n = 0;
    let most = this._least; // in variables of its own: a number in a field may be an object for every change
    let lowest = 0;
    for (let i = newest ? history.length - 1 : -1; newest && i >= 0; i -= 1) {
      const frame = history.at(i);
      const age = frame ? frame.timestamp - newest.timestamp : NaN;
      if (!frame || !(age >= -SPAN_S && age <= 0)) continue;
      for (let k = 0; k < this._series.length; k += 1) {
        const { x, y } = this._lines[k];
        x[n] = age;
        this._series[k].put(frame, y, n);
        const value = y[n];
        if (value > most) most = value;
        if (value < lowest) lowest = value;
      }
      n += 1;
    }
    this._most = most;
    this._lowest = lowest;
    for (const each of this._lines) each.length = n;
  }
}
