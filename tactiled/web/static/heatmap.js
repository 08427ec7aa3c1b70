/**
 * One pressure map: a pixel per cell of a grid, a disc or square per taxel of any other layout.
 * What is unknown is left transparent, so that the hatching behind it shows.
 * @module
 */

import { fit, pen } from "./paint.js";
import { SATURATED } from "./wire.js";

/** @typedef {import("./plane.js").Plane} Plane */
/** @typedef {import("./plane.js").Cells} Cells */
/** @typedef {import("./scale.js").Scale} Scale */
/** @typedef {import("./measures.js").Measures} Measures */

/** The 256 colours, as pixels and as CSS. */
export class Palette {
  /** @param {[number, number, number][]} colors */
  constructor(colors) {
    /** One little-endian RGBA word a colour. */
    this.words = Uint32Array.from(colors, ([r, g, b]) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0);
    this.css = colors.map(([r, g, b]) => `rgb(${r} ${g} ${b})`);
  }
}

/**
 * What is marked on a map.
 * @typedef {object} Marks
 * @property {number} lineY mm, of the cross-section; NaN for none
 * @property {number} probeX mm; NaN for none
 * @property {number} probeY mm
 * @property {boolean} pinned
 */

export class Heatmap {
  /**
   * @param {HTMLCanvasElement} canvas the cells
   * @param {HTMLCanvasElement} overlay the marks
   * @param {HTMLElement} frame what holds both
   */
  constructor(canvas, overlay, frame) {
    this.canvas = canvas;
    this.overlay = overlay;
    this.frame = frame;
    this._pen = pen(canvas);
    this._marks = pen(overlay);
    /** @type {Plane|null} */
    this._plane = null;
    /** @type {Cells|null} */
    this._cells = null;
    /** @type {ImageData|null} */
    this._image = null;
    this._words = new Uint32Array(0);
    /** CSS px per mm. */
    this.zoom = 1;
    this._ratio = 1;
    /** @type {CanvasPattern|null} */
    this._hatch = null;
  }

  /**
   * Take another sensor's cells.
   * @param {Plane} plane
   * @param {Cells} cells
   */
  use(plane, cells) {
    this._plane = plane;
    this._cells = cells;
    this.frame.classList.toggle("scattered", !plane.isGrid);
    if (plane.isGrid) {
      this.canvas.width = cells.columns;
      this.canvas.height = cells.rows;
      this._image = this._pen.createImageData(cells.columns, cells.rows);
      this._words = new Uint32Array(this._image.data.buffer);
    } else {
      this._image = null;
    }
  }

  /**
   * Take the size that the map is to be shown at.
   * @param {number} zoom CSS px per mm
   */
  resize(zoom) {
    if (!this._plane) return;
    this.zoom = zoom;
    const width = this._plane.width * zoom;
    const height = this._plane.height * zoom;
    this.frame.style.width = `${width}px`;
    this.frame.style.height = `${height}px`;
    this._ratio = fit(this.overlay, width, height);
    if (!this._plane.isGrid) fit(this.canvas, width, height);
  }

  /** Show nothing. */
  clear() {
    this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this._marks.clearRect(0, 0, this.overlay.width, this.overlay.height);
  }

  /**
   * @param {Float32Array} kpa
   * @param {Scale} scale
   * @param {Palette} palette
   */
  paint(kpa, scale, palette) {
    if (this._image) this._paintGrid(kpa, scale, palette, this._image);
    else this._paintScattered(kpa, scale, palette);
  }

  /**
   * @param {Float32Array} kpa
   * @param {Scale} scale
   * @param {Palette} palette
   * @param {ImageData} image
   */
  _paintGrid(kpa, scale, palette, image) {
    const { words } = palette;
    const out = this._words;
    const { low } = scale;
    const slope = 256 / (scale.high - low);
    for (let i = 0; i < out.length; i += 1) {
      const p = kpa[i];
      if (p !== p) {
        out[i] = 0;
      } else {
        const level = (p - low) * slope;
        out[i] = words[level <= 0 ? 0 : level >= 255 ? 255 : level | 0];
      }
    }
    this._pen.putImageData(image, 0, 0);
  }

  /**
   * @param {Float32Array} kpa
   * @param {Scale} scale
   * @param {Palette} palette
   */
  _paintScattered(kpa, scale, palette) {
    const plane = this._plane;
    const cells = this._cells;
    if (!plane || !cells) return;
    const draw = this._pen;
    draw.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const px = this.zoom * this._ratio;
    const half = (cells.side / 2) * px;
    const slope = 256 / (scale.high - scale.low);
    for (let i = 0; i < cells.count; i += 1) {
      const p = kpa[i];
      const x = (cells.x[i] - plane.left) * px;
      const y = (cells.y[i] - plane.top) * px;
      const level = (p - scale.low) * slope;
      draw.fillStyle = p !== p ? this._unknown() : palette.css[level <= 0 ? 0 : level >= 255 ? 255 : level | 0];
      draw.beginPath();
      if (plane.round) draw.arc(x, y, half, 0, 2 * Math.PI);
      else draw.rect(x - half, y - half, 2 * half, 2 * half);
      draw.fill();
    }
  }

  /** @returns {CanvasPattern|string} the hatching of a taxel of which nothing is known */
  _unknown() {
    if (!this._hatch) {
      const tile = document.createElement("canvas");
      tile.width = tile.height = 8;
      const draw = pen(tile);
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
      this._hatch = this._pen.createPattern(tile, "repeat");
    }
    return this._hatch ?? "#8d949c";
  }

  /**
   * Mark the cross-section, the probe, the centre of contact and the saturated taxels.
   * @param {Marks} marks
   * @param {Measures|null} measures
   * @param {Uint8Array|null} flags of the raw image; null where nothing is saturated
   * @param {Cells|null} taxels that the flags are of
   */
  mark(marks, measures, flags, taxels) {
    const plane = this._plane;
    if (!plane) return;
    const draw = this._marks;
    const px = this.zoom * this._ratio;
    const { width, height } = this.overlay;
    draw.clearRect(0, 0, width, height);
    if (flags && taxels) this._markSaturated(flags, taxels, px);
    if (Number.isFinite(marks.lineY)) {
      const y = (marks.lineY - plane.top) * px;
      this._stroke(0, y, width, y, true);
    }
    if (Number.isFinite(marks.probeX)) {
      const x = (marks.probeX - plane.left) * px;
      const y = (marks.probeY - plane.top) * px;
      const arm = 9 * this._ratio;
      this._stroke(x, y - arm, x, y + arm, false);
      this._stroke(x - arm, y, x + arm, y, false);
      if (marks.pinned) this._ring(x, y, 4 * this._ratio);
    }
    if (measures && measures.contact) {
      this._ring((measures.x - plane.left) * px, (measures.y - plane.top) * px, 6 * this._ratio);
    }
  }

  /**
   * @param {Uint8Array} flags
   * @param {Cells} taxels
   * @param {number} px
   */
  _markSaturated(flags, taxels, px) {
    const plane = this._plane;
    if (!plane) return;
    const half = Math.max(1.5 * this._ratio, Math.min(5 * this._ratio, 0.3 * taxels.side * px));
    const draw = this._marks;
    draw.beginPath();
    for (let i = 0; i < taxels.count; i += 1) {
      if (!(flags[i] & SATURATED)) continue;
      const x = (taxels.x[i] - plane.left) * px;
      const y = (taxels.y[i] - plane.top) * px;
      draw.moveTo(x - half, y - half);
      draw.lineTo(x + half, y + half);
      draw.moveTo(x - half, y + half);
      draw.lineTo(x + half, y - half);
    }
    this._twoTone(1.5, "#000", "#fff");
  }

  /**
   * @param {number} x0
   * @param {number} y0
   * @param {number} x1
   * @param {number} y1
   * @param {boolean} faint
   */
  _stroke(x0, y0, x1, y1, faint) {
    const draw = this._marks;
    draw.beginPath();
    draw.moveTo(x0, y0);
    draw.lineTo(x1, y1);
    if (faint) this._twoTone(1, "rgb(0 0 0 / 35%)", "rgb(255 255 255 / 65%)");
    else this._twoTone(1.5, "rgb(0 0 0 / 80%)", "#fff");
  }

  /**
   * @param {number} x
   * @param {number} y
   * @param {number} radius
   */
  _ring(x, y, radius) {
    this._marks.beginPath();
    this._marks.arc(x, y, radius, 0, 2 * Math.PI);
    this._twoTone(1.5, "rgb(0 0 0 / 80%)", "#fff");
  }

  /**
   * Stroke the path so that it shows on any colour.
   * @param {number} width CSS px
   * @param {string} under
   * @param {string} over
   */
  _twoTone(width, under, over) {
    const draw = this._marks;
    draw.lineWidth = (width + 2) * this._ratio;
    draw.strokeStyle = under;
    draw.stroke();
    draw.lineWidth = width * this._ratio;
    draw.strokeStyle = over;
    draw.stroke();
  }

  /**
   * Where on the plane a pointer is.
   * @param {PointerEvent} event
   * @param {{x: number, y: number}} into mm
   */
  locate(event, into) {
    if (!this._plane) return;
    const box = this.overlay.getBoundingClientRect();
    into.x = this._plane.left + ((event.clientX - box.left) / box.width) * this._plane.width;
    into.y = this._plane.top + ((event.clientY - box.top) / box.height) * this._plane.height;
  }
}
