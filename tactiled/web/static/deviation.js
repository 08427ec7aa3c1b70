/**
 * How sure the restored image is: its standard deviation, asked for only while somebody looks at it.
 * @module
 */

import * as api from "./api.js";
import { nearest } from "./timeline.js";

/** @import { Frame } from "./frame_history.js" */
/** @import { Plane } from "./geometry.js" */

const KEPT = 32;
const HOLDS_S = 1.5; // between the frame that a deviation is of and one that it is drawn with
const ASK_MS = 500; // it costs the service more than the image itself

export class DeviationCache {
  /** @param {string} name of the sensor @param {Plane} plane */
  constructor(name, plane) {
    this._name = name;
    this._count = plane.restored.count;
    /** @type {{timestamp: number, kpa: Float32Array}[]} */
    this._kept = [];
    this._asked = -Infinity; // ms
    this._asking = false;
    /** @param {number} back */
    this._back = (back) => this._kept[this._kept.length - 1 - back];
  }

  /** Keep nothing. */
  clear() {
    this._kept = [];
  }

  /**
   * The deviation to draw with a frame.
   * @param {number} timestamp of the frame, Unix s
   * @returns {Float32Array|null} kPa, one a restored cell; null where none is near enough in time
   */
  at(timestamp) {
    return nearest(this._kept.length, this._back, timestamp, HOLDS_S)?.kpa ?? null;
  }

  /**
   * Ask for the newest image's, unless that was done just now.
   * @param {Frame} frame the newest
   * @param {number} now ms, on performance.now's clock
   */
  ask(frame, now) {
    if (this._asking || now - this._asked < ASK_MS) return;
    const known = this._kept[this._kept.length - 1];
    if (!known || known.timestamp < frame.timestamp) this._fetch(now);
  }

  /** @param {number} now ms */
  async _fetch(now) {
    this._asking = true;
    this._asked = now;
    try {
      const told = await api.deviation(this._name);
      if (told.kpa.length !== this._count) return;
      if (this._kept.length === KEPT) this._kept.shift();
      this._kept.push(told);
    } catch {
      this._asked = now + 4 * ASK_MS; // no band is drawn meanwhile; the link's own trouble is told elsewhere
    } finally {
      this._asking = false;
    }
  }
}
