/** The legend: the shared colour scale with its ticks. @module */

import { ABOVE, BELOW } from "./colormap.js";
import { fitCanvas, themeColors, context2d } from "../shell/dom.js";
import { endsAndTicks, tickText } from "../charts/ticks.js";
import { UNITS } from "../shell/units.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */

const BAR = 16; // px across the bar
const ENDS = { standing: 9, lying: 16 }; // px kept free at each end, for half a label
const CAP = 6; // px, of what lies beyond each end

export class Colorbar {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this._pen = context2d(canvas);
    /** What was drawn last: the range, its unit, and the size, CSS px. */
    this._low = NaN;
    this._high = NaN;
    this._unit = 0;
    this._width = 0;
    this._height = 0;
  }

  /** Draw again even where nothing seems to have changed, as after a change of theme. */
  forget() {
    this._width = 0;
  }

  /** Show nothing. */
  clear() {
    this.forget();
    this._pen.setTransform(1, 0, 0, 1, 0, 0);
    this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.canvas.setAttribute("aria-label", "Colour scale");
  }

  /**
   * Draw, where the range or the size is another than the last time; tall boxes get a standing bar.
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @param {number} unit of the range
   */
  draw(range, colormap, unit) {
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    if (!width || !height) return;
    const { low, high } = range;
    if (unit === this._unit && low === this._low && high === this._high && width === this._width && height === this._height) return;
    this._low = low;
    this._high = high;
    this._unit = unit;
    this._width = width;
    this._height = height;
    this._draw(colormap);
  }

  /** @param {Colormap} colormap */
  _draw(colormap) {
    const { _low: low, _high: high, _width: width, _height: height } = this;
    this.canvas.setAttribute("aria-label", `Colour scale from ${tickText(low, high - low)} to ${tickText(high, high - low)} ${UNITS[this._unit]}`);
    const ratio = fitCanvas(this.canvas, width, height);
    const draw = this._pen;
    const ink = themeColors();
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.clearRect(0, 0, width, height);
    draw.font = `12px ${ink.font}`;
    const standing = height > width;
    const end = standing ? ENDS.standing : ENDS.lying;
    const length = (standing ? height : width) - 2 * end;
    const ramp = standing
      ? draw.createLinearGradient(0, end + length, 0, end) : draw.createLinearGradient(end, 0, end + length, 0);
    for (let i = 0; i < 256; i += 5) ramp.addColorStop(i / 255, colormap.css[i]);
    draw.fillStyle = ramp;
    if (standing) draw.fillRect(0, end, BAR, length);
    else draw.fillRect(end, 0, length, BAR);
    for (const [color, at] of /** @type {const} */ ([[ABOVE, standing ? end - CAP - 1 : end + length + 1], [BELOW, standing ? end + length + 1 : end - CAP - 1]])) {
      draw.fillStyle = colormap.css[color];
      if (standing) draw.fillRect(0, at, BAR, CAP);
      else draw.fillRect(at, 0, CAP, BAR);
    }
    draw.fillStyle = ink.text;
    draw.strokeStyle = ink.muted;
    draw.lineWidth = 1;
    draw.textAlign = standing ? "left" : "center";
    draw.textBaseline = standing ? "middle" : "top";
    for (const value of endsAndTicks(low, high, length / (standing ? 44 : 52))) {
      const at = ((value - low) / (high - low)) * length;
      const text = tickText(value, high - low);
      draw.beginPath();
      if (standing) {
        const y = Math.round(end + length - at) + 0.5;
        draw.moveTo(BAR, y);
        draw.lineTo(BAR + 5, y);
        draw.stroke();
        draw.fillText(text, BAR + 8, y);
      } else {
        const x = Math.round(end + at) + 0.5;
        draw.moveTo(x, BAR);
        draw.lineTo(x, BAR + 4);
        draw.stroke();
        const half = draw.measureText(text).width / 2;
        draw.fillText(text, Math.max(half, Math.min(width - half, x)), BAR + 6);
      }
    }
  }
}
