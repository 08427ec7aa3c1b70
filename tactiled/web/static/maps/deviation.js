/** The standard deviation of the restored image, requested only while somebody can see it. @module */

import * as api from "../wire/api.js";
import { Timeline } from "../shell/timeline.js";

/** @import { Frame } from "../wire/frame_history.js" */

const MAX_IMAGES = 32;
const SHOWN_WITHIN_S = 1.5; // of the frame that it was computed for
const INTERVAL_MS = 500; // between two requests: one costs the service more than the image itself

/** @extends {Timeline<{timestamp: number, unit: string, values: Float32Array}>} */
export class DeviationCache extends Timeline {
  /** @param {string} name of the sensor @param {number} cells of its restored image */
  constructor(name, cells) {
    super(MAX_IMAGES, SHOWN_WITHIN_S);
    this._name = name;
    this._cells = cells;
    this._requestedAt = -Infinity; // ms
    this._pending = false;
  }

  /** Request the newest image's, unless that was done just now. @param {Frame} frame the newest @param {number} now ms */
  request(frame, now) {
    if (this._pending || now - this._requestedAt < INTERVAL_MS) return;
    if (!this.newest || this.newest.timestamp < frame.timestamp) this._fetch(now);
  }

  /** @param {number} now ms */
  async _fetch(now) {
    this._pending = true;
    this._requestedAt = now;
    try {
      const deviation = await api.deviation(this._name);
      if (deviation.values.length === this._cells) this.push(deviation);
    } catch {
      this._requestedAt = now + 4 * INTERVAL_MS; // no band meanwhile; the page shows elsewhere that the link is down
    } finally {
      this._pending = false;
    }
  }
}
