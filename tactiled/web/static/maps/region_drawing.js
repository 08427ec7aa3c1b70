/** Drawing a region on a map: drag a rectangle or an ellipse, or click a cell; click the corners of a polygon. @module */

import { notice, withdraw } from "../shell/notice.js";

/** @import { Shape } from "../wire/api.js" */
/** @import { Heatmap } from "./heatmap.js" */

const KEYS = "With keys: P and Alt with arrows move a cross, Enter takes its place as a corner";
const HINTS = {
  rectangle: `Drag on a map, or click a cell. ${KEYS}.`, ellipse: `Drag on a map, or click a cell. ${KEYS}.`,
  polygon: `Click the corners on a map; the first one again, or Enter, closes the polygon. ${KEYS}, and closes it at the same place.`,
};
const CLOSE_PX = 10; // from the first corner, where a click closes a polygon; a finger may be twice as far off

export class RegionDrawing {
  /**
   * @param {Heatmap[]} maps
   * @param {() => [number, number]|null} probe mm, the place that is pinned
   * @param {() => void} onChange what is being drawn is another
   * @param {(shape: Shape, points: [number, number][]) => void} onDone it is drawn
   */
  constructor(maps, probe, onChange, onDone) {
    /** @type {Shape|null} what is being drawn; null for nothing */
    this.shape = null;
    /** @type {[number, number][]} mm */
    this.points = [];
    this._probe = probe;
    this._taken = ""; // place of the probe that is no new corner
    this._onChange = onChange;
    this._onDone = onDone;
    for (const map of maps) this._listen(map);
    document.addEventListener("keydown", (event) => this._key(event), true);
  }

  /** @param {Shape} shape */
  start(shape) {
    this.shape = shape;
    this.points = [];
    this._taken = String(this._probe());
    document.body.classList.add("drawing");
    notice(HINTS[shape]);
    this._onChange();
  }

  /** Draw nothing any more. */
  stop() {
    if (this.shape) withdraw(HINTS[this.shape]);
    this.shape = null;
    this.points = [];
    document.body.classList.remove("drawing");
    this._onChange();
  }

  /** @returns {boolean} it is a polygon that has corners enough */
  get closable() {
    return this.shape === "polygon" && this.points.length > 2;
  }

  /** Close the polygon, if that is possible; draw nothing any more. */
  end() {
    if (this.closable) this._finish();
    else this.stop();
  }

  /** @param {[number, number]} place mm, of a corner @param {number} near mm, of the first one */
  _add([x, y], near) {
    if (this.closable && Math.hypot(x - this.points[0][0], y - this.points[0][1]) < near) this._finish();
    else {
      this.points.push([x, y]);
      this._onChange();
    }
  }

  /** @param {Heatmap} map */
  _listen(map) {
    const at = (/** @type {PointerEvent} */ event) => {
      const place = { x: 0, y: 0 };
      map.locate(event, place);
      return /** @type {[number, number]} */ ([place.x, place.y]);
    };
    const take = (/** @type {PointerEvent} */ event) => {
      event.stopImmediatePropagation();
      event.preventDefault();
    };
    // In the capturing phase of the map's parent: the probe does not see what draws.
    const root = /** @type {HTMLElement} */ (map.frame.parentElement);
    root.addEventListener("pointerdown", (event) => {
      if (!this.shape || event.button !== 0) return;
      take(event);
      if (this.shape === "polygon") return;
      this.points = [at(event), at(event)];
      root.setPointerCapture(event.pointerId);
      this._onChange();
    }, true);
    root.addEventListener("pointermove", (event) => {
      if (!this.shape) return;
      take(event);
      if (this.shape === "polygon" || !this.points.length || !event.buttons) return;
      this.points[1] = at(event);
      this._onChange();
    }, true);
    root.addEventListener("pointerup", (event) => {
      if (!this.shape || event.button !== 0) return;
      take(event);
      if (this.shape === "polygon") this._add(at(event), (event.pointerType === "touch" ? 2 * CLOSE_PX : CLOSE_PX) / map.zoom);
      else if (this.points.length) {
        this.points[1] = at(event); // a quick drag's last move may not have come
        this._finish();
      }
    }, true);
  }

  /** @param {KeyboardEvent} event */
  _key(event) {
    if (!this.shape || (event.key !== "Escape" && event.key !== "Enter")) return;
    event.stopPropagation();
    event.preventDefault();
    const place = this._probe();
    if (event.key !== "Enter") this.stop();
    else if (place && (!this.points.length || String(place) !== this._taken)) this._corner(place);
    else this.end();
  }

  /** @param {[number, number]} place mm, of the probe */
  _corner(place) {
    this._taken = String(place);
    this.points.push(place);
    if (this.shape !== "polygon" && this.points.length > 1) this._finish();
    else this._onChange();
  }

  _finish() {
    const { shape, points } = this;
    this.stop();
    if (shape) this._onDone(shape, points);
  }
}
