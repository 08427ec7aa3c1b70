/**
 * A small line chart with its axes.
 * @module
 */

import { fit, inks, pen } from "./paint.js";
import { tickText, ticks } from "./scale.js";

/**
 * Points of one line; x must not fall.
 * @typedef {object} Line
 * @property {Float64Array} x
 * @property {Float64Array} y
 * @property {number} length points in use
 * @property {"raw"|"restored"|"accent"} ink
 * @property {"plain"|"steps"|"dots"} style
 * @property {Float64Array|null} spread half the height of the band about the line, at each point; null for none
 */

/**
 * @param {number} capacity
 * @param {"raw"|"restored"|"accent"} ink
 * @param {"plain"|"steps"|"dots"} style
 * @returns {Line}
 */
export function line(capacity, ink, style = "plain") {
  return { x: new Float64Array(capacity), y: new Float64Array(capacity), length: 0, ink, style, spread: null };
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

const SIDE = 46;
const HEAD = 20;
const FOOT = 34;
const TAIL = 12;
const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/**
 * @param {number} power
 * @returns {string} ten to that power
 */
function decade(power) {
  if (power === 0) return "1";
  if (power === -1) return "0.1";
  return `10${power < 0 ? "⁻" : ""}${SUPERSCRIPTS[Math.abs(power)]}`;
}

/** The ticks of an axis with their texts, made anew only where the axis has changed. */
class Ticks {
  constructor() {
    /** @type {number[]} */
    this.values = [];
    /** @type {string[]} */
    this.texts = [];
    this._low = this._high = this._most = NaN;
  }

  /**
   * @param {number} low
   * @param {number} high
   * @param {number} most
   * @returns {boolean} they are as they were
   */
  _same(low, high, most) {
    if (low === this._low && high === this._high && most === this._most) return true;
    this._low = low;
    this._high = high;
    this._most = most;
    return false;
  }

  /**
   * @param {number} low
   * @param {number} high
   * @param {number} most how many at most, about
   * @returns {this}
   */
  even(low, high, most) {
    if (this._same(low, high, most)) return this;
    this.values = ticks(low, high, most);
    this.texts = this.values.map((each) => tickText(each, high - low));
    return this;
  }

  /**
   * @param {number} low power of ten
   * @param {number} high
   * @returns {this}
   */
  decades(low, high) {
    if (this._same(low, high, Infinity)) return this;
    this.values = Array.from({ length: Math.floor(high) - Math.ceil(low) + 1 }, (_, i) => Math.ceil(low) + i);
    this.texts = this.values.map(decade);
    return this;
  }
}

export class Chart {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this._pen = pen(canvas);
    this._ink = inks();
    this._font = `12px ${this._ink.font}`;
    this._across = new Ticks();
    this._up = new Ticks();
  }

  /** Take the colours of the theme as it is now. */
  restyle() {
    this._ink = inks();
  }

  /**
   * @param {Axes} axes
   * @param {Line[]} lines
   * @param {number} [cursor] where along to draw an upright line
   * @param {string} [cursorText] what to say beside it
   */
  draw(axes, lines, cursor = NaN, cursorText = "") {
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    if (width < SIDE + TAIL + 10 || height < HEAD + FOOT + 10) return;
    const ratio = fit(this.canvas, width, height);
    const draw = this._pen;
    const ink = this._ink;
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.clearRect(0, 0, width, height);
    draw.font = this._font;
    draw.lineWidth = 1;
    const w = width - SIDE - TAIL;
    const h = height - HEAD - FOOT;
    const sx = w / (axes.right - axes.left);
    const sy = h / (axes.top - axes.bottom);
    this._grid(axes, w, h, sx, sy);
    if (cursor >= axes.left && cursor <= axes.right) {
      const x = SIDE + (cursor - axes.left) * sx;
      draw.strokeStyle = ink.text;
      draw.beginPath();
      draw.setLineDash([3, 3]);
      draw.moveTo(x, HEAD);
      draw.lineTo(x, HEAD + h);
      draw.stroke();
      draw.setLineDash([]);
      if (cursorText) {
        const right = x + 6 + draw.measureText(cursorText).width > SIDE + w;
        draw.fillStyle = ink.text;
        draw.textAlign = right ? "right" : "left";
        draw.textBaseline = "top";
        draw.fillText(cursorText, x + (right ? -6 : 6), HEAD + 2);
      }
    }
    draw.save();
    draw.beginPath();
    draw.rect(SIDE, HEAD - 2, w, h + 4);
    draw.clip();
    for (const each of lines) if (each.spread) this._band(each, each.spread, axes, h, sx, sy);
    for (const each of lines) this._line(each, axes, h, sx, sy);
    draw.restore();
  }

  /**
   * @param {Axes} axes
   * @param {number} w
   * @param {number} h
   * @param {number} sx
   * @param {number} sy
   */
  _grid(axes, w, h, sx, sy) {
    const draw = this._pen;
    const ink = this._ink;
    draw.strokeStyle = ink.line;
    draw.fillStyle = ink.muted;
    draw.textBaseline = "middle";
    draw.textAlign = "right";
    const up = axes.decades ? this._up.decades(axes.bottom, axes.top) : this._up.even(axes.bottom, axes.top, h / 28);
    draw.beginPath();
    for (let i = 0; i < up.values.length; i += 1) {
      const y = Math.round(HEAD + h - (up.values[i] - axes.bottom) * sy) + 0.5;
      draw.moveTo(SIDE, y);
      draw.lineTo(SIDE + w, y);
      draw.fillText(up.texts[i], SIDE - 6, y);
    }
    draw.textBaseline = "top";
    draw.textAlign = "center";
    const across = this._across.even(axes.left, axes.right, w / 60);
    for (let i = 0; i < across.values.length; i += 1) {
      const x = Math.round(SIDE + (across.values[i] - axes.left) * sx) + 0.5;
      draw.moveTo(x, HEAD + h);
      draw.lineTo(x, HEAD + h + 4);
      draw.fillText(across.texts[i], x, HEAD + h + 6);
    }
    draw.stroke();
    draw.textAlign = "right";
    draw.textBaseline = "bottom";
    draw.fillText(axes.x, SIDE + w, HEAD + h + FOOT);
    draw.textAlign = "left";
    draw.textBaseline = "top";
    draw.fillText(axes.y, 0, 0);
  }

  /**
   * @param {Line} of
   * @param {Float64Array} spread
   * @param {Axes} axes
   * @param {number} h
   * @param {number} sx
   * @param {number} sy
   */
  _band(of, spread, axes, h, sx, sy) {
    const draw = this._pen;
    const floor = HEAD + h + axes.bottom * sy;
    const wide = of.style === "steps" ? ((of.x[1] - of.x[0]) / 2) * sx : of.style === "dots" ? 2 : 0;
    draw.fillStyle = this._ink[of.ink];
    draw.globalAlpha = 0.28;
    draw.beginPath();
    for (let i = 0; i < of.length; i += 1) {
      const x = SIDE + (of.x[i] - axes.left) * sx;
      const y = floor - (of.y[i] + spread[i]) * sy;
      const tall = 2 * spread[i] * sy;
      if (wide && tall === tall) draw.rect(x - wide, y, 2 * wide, tall);
    }
    draw.fill();
    draw.globalAlpha = 1;
  }

  /**
   * @param {Line} of
   * @param {Axes} axes
   * @param {number} h
   * @param {number} sx
   * @param {number} sy
   */
  _line(of, axes, h, sx, sy) {
    const draw = this._pen;
    const floor = HEAD + h;
    draw.strokeStyle = draw.fillStyle = this._ink[of.ink];
    draw.lineWidth = 2;
    draw.lineJoin = "round";
    draw.beginPath();
    let down = false;
    for (let i = 0; i < of.length; i += 1) {
      const value = of.y[i];
      if (value !== value) {
        down = false;
        continue;
      }
      const x = SIDE + (of.x[i] - axes.left) * sx;
      const y = floor - (value - axes.bottom) * sy;
      if (of.style === "steps") {
        const left = i ? (of.x[i] - of.x[i - 1]) / 2 : (of.x[1] - of.x[0]) / 2;
        const right = i + 1 < of.length ? (of.x[i + 1] - of.x[i]) / 2 : left;
        if (down) draw.lineTo(x - left * sx, y);
        else draw.moveTo(x - left * sx, y);
        draw.lineTo(x + right * sx, y);
      } else if (down) draw.lineTo(x, y);
      else draw.moveTo(x, y);
      down = true;
    }
    draw.stroke();
    if (of.style !== "dots") return;
    for (let i = 0; i < of.length; i += 1) {
      if (of.y[i] !== of.y[i]) continue;
      draw.beginPath();
      draw.arc(SIDE + (of.x[i] - axes.left) * sx, floor - (of.y[i] - axes.bottom) * sy, 3, 0, 2 * Math.PI);
      draw.fill();
    }
  }
}
