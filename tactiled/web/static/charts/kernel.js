/** The cover as a blur: how much of each detail it lets through. @module */

import { Chart, line } from "./chart.js";
import { byId, setText } from "../shell/dom.js";
import { number } from "../shell/format.js";
import { lengthText } from "../shell/units.js";

/** @import { Kernel } from "../wire/api.js" */

const DECADES = -4;

export class KernelPanel {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.chart = new Chart(canvas);
    this._line = line(0, "accent");
    /** @type {Kernel|null} */
    this._kernel = null;
  }

  /** @param {Kernel|null} kernel */
  use(kernel) {
    this._kernel = kernel;
    const nyquist = byId("kernel-nyquist");
    const gap = byId("kernel-gap");
    const model = byId("kernel-model");
    if (!kernel) {
      for (const each of [nyquist, gap, model]) setText(each, "\u2013");
      this.draw();
      return;
    }
    const count = kernel.q_per_mm.length;
    this._line = line(count, "accent");
    this._line.length = count;
    for (let i = 0; i < count; i += 1) {
      this._line.x[i] = kernel.q_per_mm[i];
      const gain = Math.abs(kernel.gain[i]);
      this._line.y[i] = gain > 0 ? Math.log10(gain) : DECADES - 1;
    }
    setText(nyquist, `${gainText(kernel.nyquist_gain)} at ${number(kernel.nyquist_per_mm)} mm⁻¹`);
    setText(gap, kernel.smallest_gap_mm === null ? "none at this noise" : lengthText(kernel.smallest_gap_mm));
    setText(model, `${kernel.model}, ±${gainText(kernel.error_estimate)} of the gain`);
    this.draw();
  }

  draw() {
    const kernel = this._kernel;
    const right = kernel ? 1.5 * kernel.nyquist_per_mm : 1;
    this._line.length = kernel ? this._line.x.length : 0;
    this.chart.draw(
      { left: 0, right, bottom: DECADES, top: 0, x: "q, cycles/mm", y: "gain G(q)", decades: true },
      [this._line], kernel ? kernel.nyquist_per_mm : NaN, "Nyquist",
    );
  }
}

/** @param {number} gain @returns {string} */
function gainText(gain) {
  if (!Number.isFinite(gain)) return "\u2013";
  if (Math.abs(gain) >= 0.001 || gain === 0) return number(gain);
  const [digits, power] = gain.toExponential(2).split("e");
  return `${digits} × 10⁻${[...String(Math.abs(Number(power)))].map((each) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(each)]).join("")}`;
}
