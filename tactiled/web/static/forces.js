/**
 * Total force over the seconds that are kept.
 * @module
 */

import { Chart, line } from "./chart.js";
import { roundUp } from "./scale.js";

/** @typedef {import("./history.js").History} History */

const SPAN_S = 10;

export class Forces {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.chart = new Chart(canvas);
    this._raw = line(0, "raw");
    this._restored = line(0, "restored");
    this._lines = [this._raw, this._restored];
    /** @type {import("./chart.js").Axes} */
    this._axes = { left: -SPAN_S, right: 0, bottom: 0, top: 1, x: "time, s", y: "N" };
  }

  /** @param {History} history */
  use(history) {
    this._raw = line(history.capacity, "raw");
    this._restored = line(history.capacity, "restored");
    this._lines = [this._raw, this._restored];
    this._axes.top = 1;
  }

  /**
   * @param {History} history
   * @param {number} back which frame is shown
   */
  draw(history, back) {
    const newest = history.at(0);
    const [raw, restored] = this._lines;
    let n = 0;
    let most = 0.1;
    let least = 0;
    if (newest) {
      for (let i = history.length - 1; i >= 0; i -= 1) {
        const frame = history.at(i);
        if (!frame) continue;
        const age = frame.timestamp - newest.timestamp;
        if (age < -SPAN_S || age > 0) continue;
        raw.x[n] = restored.x[n] = age;
        raw.y[n] = frame.ofRaw.force;
        restored.y[n] = frame.ofRestored.force;
        most = Math.max(most, raw.y[n], restored.y[n]);
        least = Math.min(least, raw.y[n], restored.y[n]);
        n += 1;
      }
    }
    raw.length = restored.length = n;
    const top = roundUp(most);
    if (top > this._axes.top || roundUp(most / 0.85) < this._axes.top) this._axes.top = top;
    this._axes.bottom = least < -0.05 * top ? -roundUp(-least) : -0.06 * top;
    const shown = back ? history.at(back) : null;
    this.chart.draw(this._axes, this._lines, shown && newest ? shown.timestamp - newest.timestamp : NaN);
  }
}
