/** A pressure map in three dimensions: every cell is a column, as high as its pressure on the range. @module */

import { context2d, element, fitCanvas, themeColors } from "../shell/dom.js";
import { hatching } from "./heatmap.js";
import { isBrowsers } from "../shell/keyboard.js";
import { Columns } from "./projection.js";
import { endsAndTicks, labelledTicks, tickText } from "../charts/ticks.js";
import { UNITS } from "../shell/units.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */
/** @import { Cells, Plane } from "./geometry.js" */
/** @import { Projection } from "./projection.js" */

const DRAG_DEG = 0.5; // per CSS px
/** @type {Record<string, [number, number]>} degrees to the right and down */
const KEYS = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, -5], ArrowDown: [0, 5] };
const SHADES = [0.78, 0.58]; // of a column's colour, on its left side and on its right
const RATIO = 2; // pixels per CSS px: a screen of fewer shows their mean, so that edges are smooth
const [TICK_GAP_PX, MIN_EDGE_PX] = [34, 24]; // between two ticks; of an edge that has any
const [TEXT_PX, TICK_PX, TITLE_PX] = [11, 4, 24]; // CSS px, of letters and from an edge

export class Surface {
  /**
   * @param {"Raw"|"Restored"} name of the map
   * @param {HTMLElement} frame of the flat one
   * @param {Projection} projection that all surfaces share
   * @param {() => void} onTurn it is another
   */
  constructor(name, frame, projection, onTurn) {
    this._name = `${name} pressure map as a 3-D surface`;
    this._projection = projection;
    this._axes = element("canvas", "");
    this._axes.id = `${name.toLowerCase()}-axes`;
    this._axes.setAttribute("aria-hidden", "true");
    this.canvas = element("canvas", "");
    this.canvas.id = `${name.toLowerCase()}-surface`;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", this._name);
    frame.after(element("div", "surface", this._axes, this.canvas));
    this._pen = context2d(this.canvas);
    this._ink = themeColors();
    /** @type {Plane|null} */
    this._plane = null;
    /** @type {Columns|null} null before a sensor */
    this._columns = null;
    /** @type {Int32Array|null} the taxel whose value each column has; null: its own */
    this._taxels = null;
    this._values = new Float32Array(0); // of columns that have taxels' values
    /** @type {ImageData|null} null while it is not shown */
    this._image = null;
    this._pixels = new Uint32Array(0);
    this._ratio = this._width = this._height = 0;
    /** @type {Colormap|null} that the shades are of */
    this._colormap = null;
    /** @type {Uint32Array[]} */
    this._shades = [];
    /** The range and the unit that the axes were drawn for. */
    this._low = this._high = this._unit = NaN;
    this._listen(onTurn);
  }

  /** @param {() => void} onTurn */
  _listen(onTurn) {
    const { canvas, _projection: projection } = this;
    const first = { x: 0, y: 0 };
    const last = { x: 0, y: 0 };
    const turn = (/** @type {number} */ right, /** @type {number} */ down) => {
      projection.turn(right, down);
      onTurn();
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (!event.isPrimary || event.button) return;
      canvas.setPointerCapture(event.pointerId);
      first.x = last.x = event.clientX;
      first.y = last.y = event.clientY;
    });
    const follow = (/** @type {number} */ x, /** @type {number} */ y) => {
      turn(DRAG_DEG * (x - last.x), DRAG_DEG * (y - last.y));
      [last.x, last.y] = [x, y];
    };
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) follow(event.clientX, event.clientY);
    });
    canvas.addEventListener("pointercancel", () => follow(first.x, first.y)); // a swipe that scrolls the page
    canvas.addEventListener("dblclick", () => {
      projection.reset();
      onTurn();
    });
    canvas.addEventListener("keydown", (event) => {
      if (!(event.key in KEYS) || isBrowsers(event)) return;
      event.preventDefault(); // not for the frames that are kept
      turn(...KEYS[event.key]);
    });
  }

  /**
   * Take another sensor's cells. Taxels of no grid have the columns of the restored cells that are nearest to them.
   * @param {Plane} plane
   * @param {Cells} cells of this map
   * @param {Int32Array} taxels that the restored cells lie on; -1: on none
   */
  use(plane, cells, taxels) {
    this._plane = plane;
    this._columns = new Columns(cells.isRaster ? cells : plane.restored);
    this._taxels = cells.isRaster ? null : taxels;
    this._values = new Float32Array(taxels.length);
    this._image = null;
  }

  /** @param {number} width CSS px @param {number} height */
  resize(width, height) {
    this._ink = themeColors();
    this._ratio = fitCanvas(this.canvas, width, height, RATIO);
    fitCanvas(this._axes, width, height);
    const { canvas } = this;
    if (this._image?.width !== canvas.width || this._image.height !== canvas.height) {
      this._image = this._pen.createImageData(canvas.width, canvas.height);
      this._pixels = new Uint32Array(this._image.data.buffer);
    }
    [this._width, this._height] = [width, height];
    this.aim();
  }

  /** Take the projection as it is now. */
  aim() {
    this._columns?.aim(this._projection, this._ratio);
    this._low = NaN;
  }

  /** Show nothing. */
  clear() {
    for (const each of [this._pen, context2d(this._axes)]) each.clearRect(0, 0, each.canvas.width, each.canvas.height);
    this._low = NaN;
  }

  /** @param {Float32Array} values @param {DisplayRange} range @param {Colormap} colormap @param {number} unit of the values */
  paint(values, range, colormap, unit) {
    if (!this._columns || !this._image) return;
    if (colormap !== this._colormap) {
      this._colormap = colormap;
      this._shades = SHADES.map((share) => colormap.rgba.map((each) => shaded(each, share)));
    }
    this._pixels.fill(0);
    const { _taxels: taxels } = this;
    if (taxels) taxels.forEach((taxel, i) => { this._values[i] = values[taxel] ?? NaN; });
    this._columns.paint(this._pixels, this._image.width, taxels ? this._values : values, range, colormap, this._shades);
    this._pen.putImageData(this._image, 0, 0);
    const { low, high } = range;
    if (low === this._low && high === this._high && unit === this._unit) return;
    [this._low, this._high, this._unit] = [low, high, unit];
    this._drawAxes();
  }

  /** Draw what stands behind the columns and around them: the ground, two walls and the axes. */
  _drawAxes() {
    const { _plane: plane, _projection: at, _ink: ink, _low: low, _high: high } = this;
    if (!plane) return;
    const scale = `${tickText(low, high - low)} to ${tickText(high, high - low)} ${UNITS[this._unit]}`;
    const view = `turned by ${Math.round(at.azimuth)}°, seen from ${Math.round(at.elevation)}° above the array`;
    this.canvas.setAttribute("aria-label", `${this._name}, height ${scale}, ${view}; arrow keys turn it`);
    const draw = context2d(this._axes);
    const ratio = this._axes.width / this._width;
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.clearRect(0, 0, this._width, this._height);
    const [xs, ys] = [[plane.left, plane.left + plane.width], [plane.top, plane.top + plane.height]];
    const [backX, frontX] = at.sin < 0 ? [xs[1], xs[0]] : xs;
    const [backY, frontY] = at.cos < 0 ? [ys[1], ys[0]] : ys;
    /** @param {[number, number, number][]} places x and y, mm, and share of the range */
    const path = (...places) => {
      draw.beginPath();
      for (const [x, y, share] of places) draw.lineTo(at.left(x, y), at.top(x, y, share));
    };
    path([frontX, frontY, 0], [frontX, backY, 0], [backX, backY, 0], [backX, frontY, 0]);
    draw.fillStyle = hatching(draw);
    draw.fill();
    draw.fillStyle = ink.line;
    draw.strokeStyle = ink.muted;
    path([frontX, backY, 0], [backX, backY, 0], [backX, frontY, 0], [backX, frontY, 1], [backX, backY, 1], [frontX, backY, 1]);
    draw.globalAlpha = 0.3;
    draw.fill();
    draw.globalAlpha = 0.5;
    draw.stroke();
    path([backX, backY, 0], [backX, backY, 1]);
    draw.stroke();
    draw.font = `${TEXT_PX}px ${ink.font}`;
    draw.textBaseline = "middle";
    draw.fillStyle = ink.muted;
    // The scale stands at the corner that is farther back of the two where a wall ends.
    const [x, y] = at.top(frontX, backY, 0) < at.top(backX, frontY, 0) ? [frontX, backY] : [backX, frontY];
    const atLeft = at.left(x, y) < this._width / 2;
    const left = at.left(x, y) + (atLeft ? -2 : 2) * TICK_PX;
    draw.textAlign = atLeft ? "right" : "left";
    for (const value of at.rise < MIN_EDGE_PX ? [] : endsAndTicks(low, high, at.rise / TICK_GAP_PX)) {
      const share = (value - low) / (high - low);
      path([frontX, backY, share], [backX, backY, share], [backX, frontY, share]);
      draw.globalAlpha = 0.5;
      draw.stroke();
      draw.globalAlpha = 1;
      draw.fillText(tickText(value, high - low), left, at.top(x, y, share) - TEXT_PX / 2);
    }
    draw.globalAlpha = 1;
    if (at.rise >= MIN_EDGE_PX) draw.fillText(UNITS[this._unit], left, at.top(x, y, 1) - 1.7 * TEXT_PX);
    draw.textAlign = "center";
    this._drawEdge("x", xs, (x) => [x, frontY], frontY === ys[1] ? 1 : -1);
    this._drawEdge("y", ys, (y) => [frontX, y], frontX === xs[1] ? -1 : 1);
  }

  /**
   * Write an axis along an edge in front.
   * @param {"x"|"y"} name
   * @param {number[]} ends mm
   * @param {(along: number) => [number, number]} place on it, mm
   * @param {number} sign 1 where the array is at the left of this way, else -1
   */
  _drawEdge(name, [from, to], place, sign) {
    const { _projection: at } = this;
    const draw = context2d(this._axes);
    const points = [from, to].map((each) => ({ x: at.left(...place(each)), y: at.top(...place(each), 0) }));
    const [dx, dy] = [points[1].x - points[0].x, points[1].y - points[0].y];
    const length = Math.hypot(dx, dy);
    if (length < MIN_EDGE_PX) return;
    const [awayX, awayY] = [(-dy * sign) / length, (dx * sign) / length];
    const write = (/** @type {string} */ text, /** @type {number} */ along, /** @type {number} */ gap) => {
      const [x, y] = [at.left(...place(along)), at.top(...place(along), 0)];
      const far = gap + (Math.abs(awayX) * draw.measureText(text).width + Math.abs(awayY) * TEXT_PX) / 2;
      draw.fillText(text, x + far * awayX, y + far * awayY);
      return { x, y };
    };
    draw.beginPath();
    for (const { x, y } of points) draw.lineTo(x, y);
    for (const { value, text } of labelledTicks(from, to, length / TICK_GAP_PX)) {
      const { x, y } = write(text, value, 1.5 * TICK_PX);
      draw.moveTo(x, y);
      draw.lineTo(x + TICK_PX * awayX, y + TICK_PX * awayY);
    }
    draw.stroke();
    write(`${name}, mm`, (from + to) / 2, TITLE_PX + Math.abs(awayX) * TEXT_PX);
  }
}

/** @param {number} rgba little-endian @param {number} share of its light @returns {number} */
function shaded(rgba, share) {
  const [red, green, blue] = [0, 8, 16].map((shift) => Math.round(((rgba >> shift) & 255) * share) << shift);
  return ((255 << 24) | blue | green | red) >>> 0;
}
