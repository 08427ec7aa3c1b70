/**
 * Shear as arrows over a map: one a taxel or a restored cell, about its middle, in the direction that it is pulled.
 * Light on dark, as every mark on a map, and of a colour that neither the map nor the other marks have.
 * @module
 */

import { DisplayRange } from "./display_range.js";
import { fitCanvas, context2d, setText } from "../shell/dom.js";
import { ShearNoise } from "./shear_noise.js";
import { UNITS, shearText } from "../shell/units.js";

/** @import { Plane } from "./geometry.js" */

/**
 * What arrows are of; `least` is what the longest one stands for at least: noise alone is not drawn large.
 * @typedef {{cells: "raw"|"restored", least: number, text: (value: number) => string}} Kind
 */

/** @type {Kind} */
export const SENSED = { cells: "raw", least: 50, text: shearText };
/** @type {Kind} */
export const ON_COVER = { cells: "restored", least: 0.5, text: (value) => `${+value.toPrecision(2)} ${UNITS[0]}` };
const PITCH_SHARE = 0.9; // of the way from one arrow to the next, the longest one's length
const MAX_WIDTH_SHARE = 0.16; // of the map's width, at most: the key stands above it
const LENGTH_BOUNDS_PX = /** @type {const} */ ([14, 56]); // CSS px, within which it is; where taxels are near, arrows overlap
const MIN_LENGTH_PX = 5; // CSS px, what is drawn at all
const MIN_DEVIATIONS = 3; // standard deviations of the noise, likewise
const HEAD_SHARE = 0.45; // of an arrow's length
const MAX_HEAD_PX = 8; // CSS px, the longest side of a head
const HEAD_SLOPE = 0.5; // half of a head's width over its length
const SUBPIXELS = 16;
const NO_SHEAR = new Float32Array(0);
const DARK = "rgb(0 0 0 / 80%)";
const LIGHT = "#7df3ff";

/**
 * Add an arrow to a path, in whole units, of which FINE are a device px: any other number that is handed to the browser
 * is an object for the collector.
 * @param {CanvasRenderingContext2D} draw
 * @param {number} x of its middle
 * @param {number} y
 * @param {number} dx
 * @param {number} dy
 * @param {number} barb the longest side of its head
 */
function arrow(draw, x, y, dx, dy, barb) {
  const share = Math.min(HEAD_SHARE, barb / Math.sqrt(dx * dx + dy * dy));
  const tipX = (x + dx / 2) | 0;
  const tipY = (y + dy / 2) | 0;
  const backX = tipX - share * dx;
  const backY = tipY - share * dy;
  const across = HEAD_SLOPE * share;
  draw.moveTo(tipX - dx, tipY - dy);
  draw.lineTo(tipX, tipY);
  draw.moveTo((backX - across * dy) | 0, (backY + across * dx) | 0);
  draw.lineTo(tipX, tipY);
  draw.lineTo((backX + across * dy) | 0, (backY - across * dx) | 0);
}

/**
 * Stroke the path of arrows.
 * @param {CanvasRenderingContext2D} draw
 * @param {number} ratio device px per CSS px
 */
function strokeArrows(draw, ratio) {
  draw.lineCap = draw.lineJoin = "round";
  draw.lineWidth = Math.round(4.5 * SUBPIXELS * ratio);
  draw.strokeStyle = DARK;
  draw.stroke();
  draw.lineWidth = Math.round(2 * SUBPIXELS * ratio);
  draw.strokeStyle = LIGHT;
  draw.stroke();
}

export class ShearArrows {
  /**
   * @param {HTMLCanvasElement} canvas over the map
   * @param {HTMLElement} key of the longest arrow: a canvas and a text
   * @param {Kind} of
   */
  constructor(canvas, key, of) {
    this._of = of;
    this.canvas = canvas;
    this.range = new DisplayRange(of.least);
    this._noise = new ShearNoise();
    this._pen = context2d(canvas);
    this._key = key;
    this._keyCanvas = /** @type {HTMLCanvasElement} */ (key.querySelector("canvas"));
    this._keyPen = context2d(this._keyCanvas);
    this._keyText = /** @type {HTMLElement} */ (key.querySelector("span"));
    /** @type {Plane|null} */
    this._plane = null;
    this._ratio = 1;
    /** Device px per mm. */
    this._px = 1;
    /** Of so many cells along each axis one has an arrow. */
    this._step = 1;
    /** Length of the longest arrow, device px. */
    this._long = 0;
    /** Value that the key shows; 0: to be redrawn. */
    this._keyValue = 0;
    /** Whether nothing is drawn. */
    this.empty = true;
    /**
     * What is drawn: a frame's buffer is used again, but not with the same time.
     * @type {{shear: Float32Array, timestamp: number}}
     */
    this._last = { shear: NO_SHEAR, timestamp: NaN };
  }

  /** @returns {string} what the longest arrow stands for */
  get text() {
    return this._of.text(this.range.high);
  }

  /** @returns {number} its length, as a share of the map's width */
  get share() {
    return this._long / this.canvas.width;
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  resize(plane, zoom) {
    this._plane = plane;
    this._ratio = fitCanvas(this.canvas, plane.width * zoom, plane.height * zoom);
    this._px = zoom * this._ratio;
    const restored = this._of.cells === "restored";
    this._step = restored ? Math.ceil(LENGTH_BOUNDS_PX[0] / (plane.restored.side * zoom)) : 1;
    const apart = restored ? this._step * plane.restored.side : plane.pitch;
    const long = Math.min(PITCH_SHARE * apart, MAX_WIDTH_SHARE * plane.width) * zoom;
    this._long = Math.max(LENGTH_BOUNDS_PX[0], Math.min(LENGTH_BOUNDS_PX[1], long)) * this._ratio;
    this._keyValue = 0;
    this._last.shear = NO_SHEAR;
  }

  /** Show nothing, and forget what was seen. */
  reset() {
    this.range.reset();
    this._noise.reset();
    this.clear();
  }

  /** Show nothing. */
  clear() {
    this._key.hidden = true;
    if (!this.empty) this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.empty = true;
    this._last.shear = NO_SHEAR;
  }

  /**
   * Draw a frame's arrows, unless they are drawn already.
   * @param {Float32Array} shear along x of all taxels or cells, then along y; NaN where nothing is known
   * @param {number} timestamp of its frame, Unix s
   */
  draw(shear, timestamp) {
    const plane = this._plane;
    const last = this._last;
    if (!plane || (last.shear === shear && last.timestamp === timestamp)) return;
    if (!this._follow(shear, timestamp)) {
      this.clear();
      return;
    }
    last.shear = shear;
    last.timestamp = timestamp;
    const draw = this._pen;
    const { count, rows, columns, x, y } = plane[this._of.cells];
    const { _step: step } = this;
    const first = ((columns - 1) % step) >> 1;
    const top = ((rows - 1) % step) >> 1;
    const slope = (SUBPIXELS * this._long) / this.range.high;
    const px = SUBPIXELS * this._px;
    const minLength = Math.max(MIN_LENGTH_PX * SUBPIXELS * this._ratio, slope * MIN_DEVIATIONS * this._noise.deviation) ** 2;
    const barb = (MAX_HEAD_PX * SUBPIXELS * this._ratio) | 0;
    draw.clearRect(0, 0, this.canvas.width, this.canvas.height);
    draw.save();
    draw.scale(1 / SUBPIXELS, 1 / SUBPIXELS);
    draw.beginPath();
    for (let i = 0; i < count; i += 1) {
      if (step > 1 && ((i % columns) % step !== first || ((i / columns) | 0) % step !== top)) continue;
      const dx = slope * shear[i];
      const dy = slope * shear[count + i];
      if (!(dx * dx + dy * dy >= minLength)) continue; // NaN too
      arrow(draw, ((x[i] - plane.left) * px) | 0, ((y[i] - plane.top) * px) | 0, dx | 0, dy | 0, barb);
    }
    strokeArrows(draw, this._ratio);
    draw.restore();
    this.empty = false;
    this._updateKey();
  }

  /**
   * Let the longest arrow stand for a round number that is not below the largest shear.
   * @param {Float32Array} shear
   * @param {number} timestamp
   * @returns {boolean} some is known
   */
  _follow(shear, timestamp) {
    const count = shear.length / 2;
    let largest = -1;
    for (let i = 0; i < count; i += 1) {
      const square = shear[i] * shear[i] + shear[count + i] * shear[count + i];
      if (square > largest) largest = square;
    }
    if (largest < 0) return false;
    this._noise.follow(shear, timestamp);
    this.range.follow(Math.sqrt(largest), this._noise.deviation, timestamp);
    return true;
  }

  /** Bring the key up to date. */
  _updateKey() {
    this._key.hidden = false;
    if (this._keyValue === this.range.high) return;
    this._keyValue = this.range.high;
    const ratio = this._ratio;
    fitCanvas(this._keyCanvas, this._long / ratio + 12, 20);
    this._keyCanvas.style.width = `${this._long / ratio + 12}px`;
    this.drawKey(this._keyPen, this._keyCanvas.width / 2, this._keyCanvas.height / 2, this._long, ratio);
    setText(this._keyText, this.text);
  }

  /**
   * Draw the longest arrow.
   * @param {CanvasRenderingContext2D} draw
   * @param {number} x of its middle
   * @param {number} y
   * @param {number} length
   * @param {number} ratio device px per CSS px
   */
  drawKey(draw, x, y, length, ratio) {
    draw.save();
    draw.scale(1 / SUBPIXELS, 1 / SUBPIXELS);
    draw.beginPath();
    arrow(draw, SUBPIXELS * x, SUBPIXELS * y, SUBPIXELS * length, 0, MAX_HEAD_PX * SUBPIXELS * ratio);
    strokeArrows(draw, ratio);
    draw.restore();
  }
}
