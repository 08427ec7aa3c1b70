/** The value of each cell, written in it where cells are large enough; the legend has the unit. @module */

import { context2d, fitCanvas } from "../shell/dom.js";
import { fixed, number } from "../shell/format.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */
/** @import { Cells, Plane } from "./geometry.js" */
/** @import { Overlay } from "./overlay.js" */

const MIN_CELL_PX = 34; // CSS px, the least width of a cell that has its value
const TEXT_PX = 11;
const TEXT_SHARE = 0.92; // of a cell's width, at most
const BELOW_SHARE = 0.25; // of its side, from its middle, which lines and crosses run through, down to the text's
const MIDDLE_LUMINANCE = 118; // of 255, where black and white are read equally well

/** @param {number} rgba little-endian @returns {string} black or white, which is read better on that colour */
export function inkOn(rgba) {
  const luminance = 0.2126 * (rgba & 255) + 0.7152 * ((rgba >> 8) & 255) + 0.0722 * ((rgba >> 16) & 255);
  return luminance > MIDDLE_LUMINANCE ? "#000" : "#fff";
}

/** @param {number} value @returns {string} with less to read where there is nothing */
const valueText = (value) => (fixed(value, 2) === "0.00" ? "0" : number(value));

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
    /** What stands in each cell, and in which ink. @type {string[]} */
    this._texts = [];
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
    if (this._texts.length) this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this._texts = [];
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
    const most = TEXT_SHARE * cells.side * px;
    const high = TEXT_PX * this._ratio;
    for (let i = 0; i < cells.count; i += 1) {
      const value = values[i];
      const x = (cells.x[i] - plane.left) * px;
      const y = (cells.y[i] - plane.top + BELOW_SHARE * cells.side) * px;
      const isFree = !Number.isNaN(value) && !marks?.isLabelled(x, y, most / 2, high / 2);
      const text = isFree ? valueText(value) : "";
      const ink = isFree ? inkOn(colormap.rgba[colormap.index(value, range)]) : "";
      if (this._texts[i] === ink + text) continue;
      this._texts[i] = ink + text;
      draw.clearRect(x - most / 2, y - high, most, 2 * high);
      draw.fillStyle = ink;
      draw.fillText(text, x, y, most);
    }
  }
}
