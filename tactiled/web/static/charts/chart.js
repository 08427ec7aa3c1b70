/** A small line chart with its axes. @module */

import { fitCanvas, themeColors, context2d } from "../shell/dom.js";
import { decadeTicks, labelledTicks } from "./ticks.js";

/** @import { Ink } from "../shell/dom.js" */

/** @type {number[]} */
const SOLID = [];

/**
 * Points of one line; x must not fall. The arrays of a plain line may be rings.
 * @typedef {object} Line
 * @property {Float64Array} x
 * @property {Float64Array} y
 * @property {number} first the index of the first point
 * @property {number} length points in use
 * @property {number} zero the x that is drawn as 0
 * @property {Ink} ink
 * @property {"plain"|"steps"|"dots"|"points"} style points have no line between them
 * @property {number} step how wide one of the steps is, in units of x
 * @property {Float64Array|null} spread half the height of the band about the line, at each point; null for none
 * @property {number[]} dash lengths of dashes and gaps, units of lines; none for a solid line
 */

/**
 * @param {number} capacity
 * @param {Ink} ink
 * @param {"plain"|"steps"|"dots"|"points"} style
 * @param {number} step
 * @returns {Line}
 */
export function line(capacity, ink, style = "plain", step = 0) {
  const x = new Float64Array(capacity);
  const y = new Float64Array(capacity);
  return { x, y, first: 0, length: 0, zero: 0, ink, style, step, spread: null, dash: SOLID };
}

/**
 * @param {number[]} time
 * @param {(number|null)[]} values null: not known
 * @param {number} maxGap between two values that a line joins
 * @param {Ink} ink
 * @param {number[]} [dash] lengths of dashes and gaps, CSS px
 * @returns {Line} with a gap where a value is not known, or the next comes later
 */
export function gappedLine(time, values, maxGap, ink, dash = SOLID) {
  /** @type {number[]} */
  const x = [];
  /** @type {number[]} */
  const y = [];
  values.forEach((value, i) => {
    if (time[i] - time[i - 1] > maxGap) {
      x.push(time[i]);
      y.push(NaN);
    }
    x.push(time[i]);
    y.push(value ?? NaN);
  });
  return { ...line(0, ink), x: new Float64Array(x), y: new Float64Array(y), length: x.length, dash: dash.map((each) => each * SUBPIXELS) };
}

/**
 * @typedef {object} Axes
 * @property {number} left
 * @property {number} right
 * @property {number} bottom
 * @property {number} top
 * @property {string} x what runs along, with its unit
 * @property {string} y what runs up, with its unit
 * @property {boolean} [decades] bottom and top are powers of ten, and so are the values
 */

export const PLOT_LEFT_PX = 46; // CSS px, beside the lines
export const PLOT_RIGHT_PX = 12;
const TOP_PX = 20;
const BOTTOM_PX = 34;
const SUBPIXELS = 16; // units of lines in a CSS px: whole, as any other number handed to the browser may be an object
const LONE = SUBPIXELS; // half the side of the square, between its strokes, where no line reaches a value
const DASHES = [6 * SUBPIXELS, 4 * SUBPIXELS]; // of the raw line, where colours are few
const OFFSCREEN = 2 ** 24; // of such units, out of sight

/** @param {number} at @returns {number} a whole number near it, out of sight where it is */
const toInt = (at) => (at > OFFSCREEN ? OFFSCREEN : at < -OFFSCREEN ? -OFFSCREEN : at | 0);

export class Chart {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this._pen = context2d(canvas);
    this._ink = themeColors();
    this._font = `12px ${this._ink.font}`;
    /** The axes, on a canvas of their own: text is the dearest part of a chart, and seldom another. */
    this._axesContext = context2d(document.createElement("canvas"));
    /** What is painted there. */
    this._paintedAxes = { left: NaN, right: NaN, bottom: NaN, top: NaN, x: "", y: "", ratio: NaN, ink: this._ink };
    /** Size of the part with the lines, CSS px, and CSS px a unit; kept in fields: passing them would allocate numbers. */
    this._w = this._h = this._sx = this._sy = 0;
  }

  /** Take the colours of the theme as it is now. */
  restyle() {
    this._ink = themeColors();
  }

  /** Show nothing. */
  clear() {
    this._pen.setTransform(1, 0, 0, 1, 0, 0);
    this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  /**
   * @param {Axes} axes
   * @param {Line[]} lines
   * @param {number} [cursor] where along to draw an upright line
   * @param {string} [cursorText] what to say beside it
   */
  draw(axes, lines, cursor = NaN, cursorText = "") {
    const { canvas } = this;
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (width < PLOT_LEFT_PX + PLOT_RIGHT_PX + 10 || height < TOP_PX + BOTTOM_PX + 10) return;
    const ratio = fitCanvas(canvas, width, height);
    this._w = width - PLOT_LEFT_PX - PLOT_RIGHT_PX;
    this._h = height - TOP_PX - BOTTOM_PX;
    this._sx = this._w / (axes.right - axes.left);
    this._sy = this._h / (axes.top - axes.bottom);
    this._axes(axes, ratio);
    const draw = this._pen;
    this.clear();
    draw.drawImage(this._axesContext.canvas, 0, 0);
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (cursor >= axes.left && cursor <= axes.right) this._cursor(PLOT_LEFT_PX + (cursor - axes.left) * this._sx, cursorText);
    draw.save();
    draw.beginPath();
    draw.rect(PLOT_LEFT_PX, TOP_PX - 2, this._w, this._h + 4);
    draw.clip();
    draw.scale(1 / SUBPIXELS, 1 / SUBPIXELS);
    for (let k = 0; k < lines.length; k += 1) this._band(lines[k], axes);
    for (let k = 0; k < lines.length; k += 1) this._line(lines[k], axes);
    draw.restore();
  }

  /** @param {number} x CSS px @param {string} text */
  _cursor(x, text) {
    const draw = this._pen;
    draw.font = this._font;
    draw.lineWidth = 1;
    draw.strokeStyle = draw.fillStyle = this._ink.text;
    draw.beginPath();
    draw.setLineDash([3, 3]);
    draw.moveTo(x, TOP_PX);
    draw.lineTo(x, TOP_PX + this._h);
    draw.stroke();
    draw.setLineDash([]);
    if (!text) return;
    const right = x + 6 + draw.measureText(text).width > PLOT_LEFT_PX + this._w;
    draw.textAlign = right ? "right" : "left";
    draw.textBaseline = "top";
    draw.strokeStyle = this._ink.panel;
    draw.lineWidth = 4;
    draw.strokeText(text, x + (right ? -6 : 6), TOP_PX + 2);
    draw.fillText(text, x + (right ? -6 : 6), TOP_PX + 2);
  }

  /**
   * Paint the axes where they, the size or the theme have changed.
   * @param {Axes} axes
   * @param {number} ratio device px a CSS px
   */
  _axes(axes, ratio) {
    const { left, right, bottom, top, x, y } = axes;
    const { _axesContext: draw, _paintedAxes: painted, _ink: ink, canvas } = this;
    const size = draw.canvas.width === canvas.width && draw.canvas.height === canvas.height;
    if (size && painted.left === left && painted.right === right && painted.bottom === bottom && painted.top === top
      && painted.x === x && painted.y === y && painted.ratio === ratio && painted.ink === ink) return;
    this._paintedAxes = { left, right, bottom, top, x, y, ratio, ink };
    canvas.dataset.unit = y;
    draw.canvas.width = canvas.width; // which clears it, too
    draw.canvas.height = canvas.height;
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.font = this._font;
    this._grid(axes, this._w, this._h);
  }

  /** @param {Axes} axes @param {number} w @param {number} h */
  _grid(axes, w, h) {
    const draw = this._axesContext;
    const ink = this._ink;
    draw.strokeStyle = ink.line;
    draw.fillStyle = ink.muted;
    draw.textBaseline = "middle";
    draw.textAlign = "right";
    const { bottom, top } = axes;
    draw.beginPath();
    for (const { value, text } of axes.decades ? decadeTicks(bottom, top) : labelledTicks(bottom, top, h / 28)) {
      const y = Math.round(TOP_PX + h - (value - bottom) * this._sy) + 0.5;
      draw.moveTo(PLOT_LEFT_PX, y);
      draw.lineTo(PLOT_LEFT_PX + w, y);
      draw.fillText(text, PLOT_LEFT_PX - 6, y);
    }
    draw.textBaseline = "top";
    draw.textAlign = "center";
    for (const { value, text } of labelledTicks(axes.left, axes.right, w / 60)) {
      const x = Math.round(PLOT_LEFT_PX + (value - axes.left) * this._sx) + 0.5;
      draw.moveTo(x, TOP_PX + h);
      draw.lineTo(x, TOP_PX + h + 4);
      draw.fillText(text, x, TOP_PX + h + 6);
    }
    draw.stroke();
    draw.textAlign = "right";
    draw.textBaseline = "bottom";
    draw.fillText(axes.x, PLOT_LEFT_PX + w, TOP_PX + h + BOTTOM_PX);
    draw.textAlign = "left";
    draw.textBaseline = "top";
    draw.fillText(axes.y, 0, 0);
  }

  /** @param {Line} of @param {Axes} axes */
  _band(of, axes) {
    const { _pen: draw } = this;
    const sx = SUBPIXELS * this._sx;
    const sy = SUBPIXELS * this._sy;
    const { spread } = of;
    if (!spread) return;
    const floor = SUBPIXELS * (TOP_PX + this._h) + axes.bottom * sy;
    const wide = of.style === "steps" ? Math.ceil((of.step / 2) * sx) : of.style === "dots" ? 2 * SUBPIXELS : 0;
    draw.fillStyle = this._ink[of.ink];
    draw.globalAlpha = 0.28;
    draw.beginPath();
    for (let i = 0; i < of.length; i += 1) {
      const x = toInt(SUBPIXELS * PLOT_LEFT_PX + (of.x[i] - axes.left) * sx);
      const y = toInt(floor - (of.y[i] + spread[i]) * sy);
      const tall = 2 * spread[i] * sy;
      if (wide && tall === tall) draw.rect(x - wide, y, 2 * wide, toInt(tall));
    }
    draw.fill();
    draw.globalAlpha = 1;
  }

  /** @param {Line} of @param {Axes} axes */
  _line(of, axes) {
    const { _pen: draw } = this;
    const sx = SUBPIXELS * this._sx;
    const sy = SUBPIXELS * this._sy;
    const floor = SUBPIXELS * (TOP_PX + this._h);
    const from = of.zero + axes.left;
    const half = ((of.step / 2) * sx) | 0;
    draw.strokeStyle = draw.fillStyle = this._ink[of.ink];
    draw.lineWidth = 2 * SUBPIXELS;
    draw.lineJoin = "round";
    draw.beginPath();
    let down = false;
    for (let i = 0, at = of.first; i < of.length; i += 1, at = at + 1 < of.x.length ? at + 1 : 0) {
      const value = of.y[at];
      if (value !== value) {
        down = false;
        continue;
      }
      const x = toInt(SUBPIXELS * PLOT_LEFT_PX + (of.x[at] - from) * sx);
      const y = toInt(floor - (value - axes.bottom) * sy);
      if (down) draw.lineTo(x - half, y);
      else {
        const next = of.y[at + 1 < of.x.length ? at + 1 : 0];
        if (!half && (next !== next || i + 1 === of.length)) draw.rect(x - LONE, y - LONE, 2 * LONE, 2 * LONE);
        draw.moveTo(x - half, y);
      }
      if (half) draw.lineTo(x + half, y);
      down = true;
    }
    const dash = this._ink.forced && of.ink === "raw" ? DASHES : of.dash;
    if (dash.length) draw.setLineDash(dash);
    if (of.style !== "points") draw.stroke();
    if (dash.length) draw.setLineDash(SOLID);
    if (of.style === "dots" || of.style === "points") this._dots(of, axes, sx, sy);
  }

  /** @param {Line} of @param {Axes} axes @param {number} sx fine units a unit of x @param {number} sy */
  _dots(of, axes, sx, sy) {
    const { _pen: draw } = this;
    const floor = SUBPIXELS * (TOP_PX + this._h);
    for (let i = 0; i < of.length; i += 1) {
      if (of.y[i] !== of.y[i]) continue;
      draw.beginPath();
      const x = toInt(SUBPIXELS * PLOT_LEFT_PX + (of.x[i] - axes.left) * sx);
      draw.arc(x, toInt(floor - (of.y[i] - axes.bottom) * sy), 3 * SUBPIXELS, 0, 2 * Math.PI);
      draw.fill();
    }
  }
}
