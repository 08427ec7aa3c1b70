/** The value of each cell, written in it where cells are large enough; the legend has the unit. @module */

import { context2d, fitCanvas } from "../shell/dom.js";
import { number } from "../shell/format.js";

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
    this._empty = true;
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  resize(plane, zoom) {
    this._zoom = zoom;
    this._ratio = fitCanvas(this.canvas, plane.width * zoom, plane.height * zoom);
    this.clear();
  }

  /** Show nothing. */
  clear() {
    if (!this._empty) this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this._empty = true;
  }

  /**
   * @param {Float32Array} values
   * @param {Plane} plane
   * @param {Cells} cells
   * @param {DisplayRange} range
   * @param {Colormap} colormap that they are painted in
   * @param {Overlay} [marks] of the map: a cell under one of its labels has no value
   */
  draw(values, plane, cells, range, colormap, marks) {
    this.clear();
    if (cells.side * this._zoom < MIN_CELL_PX) return;
    const draw = this._pen;
    const px = this._zoom * this._ratio;
    const most = TEXT_SHARE * cells.side * px;
    draw.font = `${TEXT_PX * this._ratio}px ${getComputedStyle(document.body).fontFamily}`;
    draw.textAlign = "center";
    draw.textBaseline = "middle";
    for (let i = 0; i < cells.count; i += 1) {
      if (Number.isNaN(values[i])) continue;
      const text = number(values[i]);
      const x = (cells.x[i] - plane.left) * px;
      const y = (cells.y[i] - plane.top + BELOW_SHARE * cells.side) * px;
      const width = Math.min(most, draw.measureText(text).width);
      if (marks?.isLabelled(x, y, width / 2, (TEXT_PX / 2) * this._ratio)) continue;
      draw.fillStyle = inkOn(colormap.rgba[colormap.index(values[i], range)]);
      draw.fillText(text, x, y, most);
    }
    this._empty = false;
  }
}
