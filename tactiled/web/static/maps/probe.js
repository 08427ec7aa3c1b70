/** The point that is probed: under the pointer, or pinned. @module */

/** @import { Plane } from "./geometry.js" */
/** @import { Heatmap } from "./heatmap.js" */

const TAP_SLIP_PX = 10; // that a tap may slip, and within which a pinned place is the same

export class Probe {
  /**
   * @param {Heatmap[]} maps
   * @param {(deliberate: boolean) => void} onMove whether it was pinned, moved by keys or released, not just pointed
   */
  constructor(maps, onMove) {
    /** Place, mm; NaN when nothing is probed. */
    this.x = NaN;
    this.y = NaN;
    this.pinned = false;
    this._onMove = onMove;
    this._at = { x: NaN, y: NaN };
    /** Where a finger came down, CSS px; NaN where none did, or it has moved on: then it scrolls the page. */
    this._touch = { x: NaN, y: NaN };
    for (const map of maps) this._listen(map);
  }

  /** @param {Heatmap} map */
  _listen(map) {
    const surface = map.frame;
    surface.addEventListener("pointermove", (event) => {
      if (event.pointerType === "touch") this._moved(event);
      else if (!this.pinned || event.buttons & 1) this._follow(map, event);
    });
    surface.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      if (event.pointerType !== "touch") this._press(map, event);
      else this._touch = event.isPrimary ? { x: event.clientX, y: event.clientY } : { x: NaN, y: NaN };
    });
    surface.addEventListener("pointerup", (event) => {
      if (event.pointerType !== "touch") return;
      this._moved(event);
      if (Number.isFinite(this._touch.x)) this._press(map, event);
      this._touch.x = NaN;
    });
    surface.addEventListener("pointercancel", () => { this._touch.x = NaN; });
    surface.addEventListener("pointerleave", (event) => {
      if (!this.pinned && event.pointerType !== "touch") this.clear();
    });
  }

  /** @param {PointerEvent} event of a finger */
  _moved(event) {
    if (Math.hypot(event.clientX - this._touch.x, event.clientY - this._touch.y) > TAP_SLIP_PX) this._touch.x = NaN;
  }

  /** Pin here, or release what is pinned here. @param {Heatmap} map @param {PointerEvent} event */
  _press(map, event) {
    map.locate(event, this._at);
    const near = event.pointerType === "touch" ? 2 * TAP_SLIP_PX : TAP_SLIP_PX;
    const same = this.pinned && Math.hypot(this._at.x - this.x, this._at.y - this.y) * map.zoom < near;
    if (same && event.pointerType === "touch") {
      this.clear();
      return;
    }
    this.pinned = !same;
    this._follow(map, event, true);
  }

  clear() {
    const { pinned } = this;
    this.pinned = false;
    this.x = this.y = NaN;
    this._onMove(pinned);
  }

  /** Pin at a place. @param {number} x mm @param {number} y mm */
  pin(x, y) {
    this.pinned = true;
    this.x = x;
    this.y = y;
    this._onMove(true);
  }

  /** Move a pinned probe, within the plane. @param {number} dx mm @param {number} dy mm @param {Plane} plane */
  nudge(dx, dy, plane) {
    if (!this.pinned) return;
    this.x = Math.max(plane.left, Math.min(plane.left + plane.width, this.x + dx));
    this.y = Math.max(plane.top, Math.min(plane.top + plane.height, this.y + dy));
    this._onMove(true);
  }

  /** @param {Heatmap} map @param {PointerEvent} event @param {boolean} [deliberate] */
  _follow(map, event, deliberate = false) {
    map.locate(event, this._at);
    this.x = this._at.x;
    this.y = this._at.y;
    this._onMove(deliberate);
  }
}
