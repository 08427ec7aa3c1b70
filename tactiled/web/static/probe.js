/**
 * The point that is asked about: under the pointer, or pinned.
 * @module
 */

/** @typedef {import("./heatmap.js").Heatmap} Heatmap */
/** @typedef {import("./plane.js").Plane} Plane */

export class Probe {
  /**
   * @param {Heatmap[]} maps
   * @param {() => void} onMove
   */
  constructor(maps, onMove) {
    /** Place, mm; NaN when nothing is asked about. */
    this.x = NaN;
    this.y = NaN;
    this.pinned = false;
    this._onMove = onMove;
    this._at = { x: NaN, y: NaN };
    for (const map of maps) {
      const { overlay } = map;
      overlay.addEventListener("pointermove", (event) => {
        if (this.pinned && !(event.buttons & 1)) return;
        this._follow(map, event);
      });
      overlay.addEventListener("pointerdown", (event) => {
        if (event.button !== 0) return;
        map.locate(event, this._at);
        const same = this.pinned && Math.hypot(this._at.x - this.x, this._at.y - this.y) * map.zoom < 8;
        this.pinned = !same;
        this._follow(map, event);
      });
      overlay.addEventListener("pointerleave", () => {
        if (!this.pinned) this.clear();
      });
    }
  }

  clear() {
    this.pinned = false;
    this.x = this.y = NaN;
    this._onMove();
  }

  /**
   * Pin at a place.
   * @param {number} x mm
   * @param {number} y mm
   */
  pin(x, y) {
    this.pinned = true;
    this.x = x;
    this.y = y;
    this._onMove();
  }

  /**
   * Move a pinned probe, within the plane.
   * @param {number} dx mm
   * @param {number} dy mm
   * @param {Plane} plane
   */
  nudge(dx, dy, plane) {
    if (!this.pinned) return;
    this.x = Math.max(plane.left, Math.min(plane.left + plane.width, this.x + dx));
    this.y = Math.max(plane.top, Math.min(plane.top + plane.height, this.y + dy));
    this._onMove();
  }

  /**
   * @param {Heatmap} map
   * @param {PointerEvent} event
   */
  _follow(map, event) {
    map.locate(event, this._at);
    this.x = this._at.x;
    this.y = this._at.y;
    this._onMove();
  }
}
