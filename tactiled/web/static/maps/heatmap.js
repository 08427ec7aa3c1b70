/**
 * One pressure map: a pixel per cell in rows and columns, a disc or square per taxel of any other layout.
 * What is unknown is left transparent, so that the hatching behind it shows; it is grey where there is none behind.
 * @module
 */

import { fitCanvas, context2d } from "../shell/dom.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */
/** @import { Cells, Plane } from "./geometry.js" */

const UNKNOWN = [0xff9c948d, 0xff68615b]; // of every other cell: the two colours of the hatching, little-endian

export class Heatmap {
  /** @param {HTMLCanvasElement} canvas the cells @param {HTMLElement} frame what holds it */
  constructor(canvas, frame) {
    this.canvas = canvas;
    this.frame = frame;
    this._pen = context2d(canvas);
    /** @type {Plane|null} */
    this._plane = null;
    /** @type {Cells|null} */
    this._cells = null;
    /** @type {ImageData|null} */
    this._image = null;
    this._pixels = new Uint32Array(0);
    this._blank = new Uint32Array(0); // what a cell without data is painted
    /** CSS px per mm. */
    this.zoom = 1;
    this._ratio = 1;
    /** @type {CanvasPattern|string|null} */
    this._hatch = null;
  }

  /** Take another sensor's cells. @param {Plane} plane @param {Cells} cells */
  use(plane, cells) {
    this._plane = plane;
    this._cells = cells;
    this.frame.classList.toggle("scattered", !plane.isGrid);
    this.frame.classList.toggle("raster", cells.isRaster);
    if (cells.isRaster) {
      this.canvas.width = cells.columns;
      this.canvas.height = cells.rows;
      this._image = this._pen.createImageData(cells.columns, cells.rows);
      this._pixels = new Uint32Array(this._image.data.buffer);
      this._blank = Uint32Array.from(cells.area, (area, i) => (plane.isGrid || !area ? 0 : UNKNOWN[(i + Math.floor(i / cells.columns)) % 2]));
    } else {
      this._image = null;
    }
  }

  /** Take the size that the map is to be shown at. @param {number} zoom CSS px per mm */
  resize(zoom) {
    if (!this._plane) return;
    this.zoom = zoom;
    const width = this._plane.width * zoom;
    const height = this._plane.height * zoom;
    this.frame.style.width = `${width}px`;
    this.frame.style.height = `${height}px`;
    if (!this._image) this._ratio = fitCanvas(this.canvas, width, height);
  }

  /** Show nothing. */
  clear() {
    this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  /** @param {Float32Array} values @param {DisplayRange} range @param {Colormap} colormap */
  paint(values, range, colormap) {
    if (this._image) this._paintRaster(values, range, colormap, this._image);
    else this._paintScattered(values, range, colormap);
  }

  /**
   * @param {Float32Array} values
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @param {ImageData} image
   */
  _paintRaster(values, range, colormap, image) {
    const { rgba } = colormap;
    const { _pixels: out, _blank: blank } = this;
    for (let i = 0; i < out.length; i += 1) {
      const p = values[i];
      out[i] = p !== p ? blank[i] : rgba[colormap.index(p, range)];
    }
    this._pen.putImageData(image, 0, 0);
  }

  /** @param {Float32Array} values @param {DisplayRange} range @param {Colormap} colormap */
  _paintScattered(values, range, colormap) {
    const plane = this._plane;
    const cells = this._cells;
    if (!plane || !cells) return;
    const draw = this._pen;
    draw.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const px = this.zoom * this._ratio;
    const half = (cells.side / 2) * px;
    for (let i = 0; i < cells.count; i += 1) {
      const p = values[i];
      const x = (cells.x[i] - plane.left) * px;
      const y = (cells.y[i] - plane.top) * px;
      draw.fillStyle = p !== p ? this._unknown() : colormap.css[colormap.index(p, range)];
      draw.beginPath();
      if (plane.round) draw.arc(x, y, half, 0, 2 * Math.PI);
      else draw.rect(x - half, y - half, 2 * half, 2 * half);
      draw.fill();
    }
  }

  /** @returns {CanvasPattern|string} the hatching of a taxel of which nothing is known */
  _unknown() {
    this._hatch ??= hatching(this._pen);
    return this._hatch;
  }

  /** Where on the plane a pointer is. @param {PointerEvent} event @param {{x: number, y: number}} into mm */
  locate(event, into) {
    if (!this._plane) return;
    const box = this.canvas.getBoundingClientRect();
    into.x = this._plane.left + ((event.clientX - box.left) / box.width) * this._plane.width;
    into.y = this._plane.top + ((event.clientY - box.top) / box.height) * this._plane.height;
  }
}

/** @param {CanvasRenderingContext2D} pen @returns {CanvasPattern|string} fills what is unknown */
export function hatching(pen) {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 8;
  const draw = context2d(tile);
  draw.fillStyle = "#8d949c";
  draw.fillRect(0, 0, 8, 8);
  draw.strokeStyle = "#5b6168";
  draw.lineWidth = 2;
  draw.beginPath();
  for (const shift of [-8, 0, 8]) {
    draw.moveTo(shift - 1, 9);
    draw.lineTo(shift + 9, -1);
  }
  draw.stroke();
  return pen.createPattern(tile, "repeat") ?? "#8d949c";
}
