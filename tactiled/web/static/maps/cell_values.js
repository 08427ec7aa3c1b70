/** The value of each cell, written in it where cells are large enough; the legend has the unit. @module */

import { context2d, fitCanvas } from "../shell/dom.js";
import { fixed } from "../shell/format.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */
/** @import { Cells, Plane } from "./geometry.js" */
/** @import { Overlay } from "./overlay.js" */

const MIN_CELL_PX = 34; // CSS px, the least width of a cell that has its value
const TEXT_PX = 11;
const TEXT_SHARE = 0.92; // of a cell's width, at most
const BELOW_SHARE = 0.25; // of its side, from its middle, which lines and crosses run through, down to the text's
const EMPTY = -1e300; // in the place of a cell's digits
const MAX_TEXTS = 10_000;
const MIDDLE_LUMINANCE = 118; // of 255, where black and white are read equally well

/** @param {number} rgba little-endian @returns {string} black or white, which is read better on that colour */
export function inkOn(rgba) {
  const luminance = 0.2126 * (rgba & 255) + 0.7152 * ((rgba >> 8) & 255) + 0.0722 * ((rgba >> 16) & 255);
  return luminance > MIDDLE_LUMINANCE ? "#000" : "#fff";
}

/** @param {number} value @returns {number} its three digits and their decimals in one whole number: two that are equal read alike */
function digitsOf(value) {
  const size = Math.abs(value);
  if (size < 0.9995) return Math.round(value * 1000) * 4 + 3;
  if (size < 9.995) return Math.round(value * 100) * 4 + 2;
  return size < 99.95 ? Math.round(value * 10) * 4 + 1 : Math.round(value) * 4;
}

/** By digits. Nobody has to make them again, or to collect them, sixty times a second. @type {Map<number, string>} */
const texts = new Map();

/** @param {number} digits @returns {string} */
function textOf(digits) {
  const known = texts.get(digits);
  if (known !== undefined) return known;
  const decimals = ((digits % 4) + 4) % 4;
  const whole = (digits - decimals) / 4;
  const text = whole ? fixed(whole / 10 ** decimals, decimals) : "0"; // there is less to read where there is nothing
  if (texts.size > MAX_TEXTS) texts.clear();
  texts.set(digits, text);
  return text;
}

export class CellValues {
  /** @param {HTMLCanvasElement} map that it stands over */
  constructor(map) {
    this.canvas = document.createElement("canvas");
    this.canvas.className = "marks values";
    this.canvas.setAttribute("aria-hidden", "true");
    map.after(this.canvas);
    this._pen = context2d(this.canvas);
    this._ratio = 1;
    this._zoom = 0;
    this._written = new Float64Array(0); // twice the digits of each cell, and one more for white ink
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  resize(plane, zoom) {
    this._zoom = zoom;
    this._ratio = fitCanvas(this.canvas, plane.width * zoom, plane.height * zoom);
    this._pen.font = `${TEXT_PX * this._ratio}px ${getComputedStyle(document.body).fontFamily}`;
    this._pen.textAlign = "center";
    this._pen.textBaseline = "middle";
    this.clear();
  }

  /** Show nothing. */
  clear() {
    if (this._written.length) this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this._written = new Float64Array(0);
  }

  /**
   * Write what differs from what stands there.
   * @param {Float32Array} values
   * @param {Plane} plane
   * @param {Cells} cells
   * @param {DisplayRange} range
   * @param {Colormap} colormap that they are painted in
   * @param {Overlay} [marks] of the map: a cell under one of its labels has no value
   */
  draw(values, plane, cells, range, colormap, marks) {
    if (cells.side * this._zoom < MIN_CELL_PX) return;
    const draw = this._pen;
    const px = this._zoom * this._ratio;
    // Whole pixels: texts are sharp, and a number that is passed on leaves no garbage.
    const most = Math.floor(TEXT_SHARE * cells.side * px);
    const half = Math.floor(most / 2);
    const high = Math.ceil(TEXT_PX * this._ratio);
    if (this._written.length !== cells.count) this._written = new Float64Array(cells.count).fill(EMPTY);
    const { _written: written } = this;
    for (let i = 0; i < cells.count; i += 1) {
      const value = values[i];
      const x = Math.round((cells.x[i] - plane.left) * px);
      const y = Math.round((cells.y[i] - plane.top + BELOW_SHARE * cells.side) * px);
      const isFree = !Number.isNaN(value) && !marks?.isLabelled(x, y, half, high >> 1);
      const ink = isFree ? inkOn(colormap.rgba[colormap.index(value, range)]) : "";
      const digits = isFree ? digitsOf(value) : EMPTY;
      const is = isFree ? 2 * digits + (ink === "#fff" ? 1 : 0) : EMPTY;
      if (written[i] === is) continue;
      written[i] = is;
      draw.clearRect(x - half, y - high, most, 2 * high);
      if (!isFree) continue;
      draw.fillStyle = ink;
      draw.fillText(textOf(digits), x, y, most);
    }
  }
}
