/** Which image may still be shown as the present: none that waited on its way, or for a page that stood still. @module */

/** @import { Status } from "../wire/sensor_stream.js" */

const MAX_DELAY_S = 0.08; // behind the quickest image, which took some ms itself: no more than 0.1 in all
const CLOCK_DRIFT = 1e-3; // that the two clocks' rates may differ by
const MAX_RETRIES = 4; // requests for a newer image between two paintings; then a late one is painted
const NEWER_S = 0.5; // after one was requested: a status that is handled sooner may have waited with the late image

/** Times are Unix s: `sent` by the service's clock, `now` by this browser's. */
export class Freshness {
  constructor() {
    /** Least of (arrival - sent), s: how far this browser's clock is ahead of the service's, plus the quickest way. */
    this.minDelay = Infinity;
    /** How many of the newest images are held back. */
    this.heldBack = 0;
    this._arrivedAt = 0;
    this._delay = 0; // s, of the newest image that was checked
    this._paintedDelay = 0; // s, of the last one painted: on a slow page the next is as late
    this._retries = 0;
    this._heldAt = 0;
  }

  /** An image came. @param {number} sent @param {number} now */
  arrived(sent, now) {
    const elapsed = Math.max(0, Math.min(1, now - this._arrivedAt));
    this._arrivedAt = now;
    this.minDelay = Math.min(now - sent, this.minDelay + CLOCK_DRIFT * elapsed);
  }

  /**
   * Hold back images that waited too long, unless all that replaced them are late, too: then a clock was set or
   * everything is slow, and waiting would show nothing newer.
   * @param {number} sent of the newest image that is not painted yet
   * @param {number} count of images that are not painted yet
   * @param {number} now
   * @returns {boolean} they are held back: request newer ones
   */
  holdBack(sent, count, now) {
    const delay = now - sent;
    this._delay = delay - this.minDelay;
    if (this._delay <= (this._paintedDelay > MAX_DELAY_S ? 2 * this._paintedDelay : MAX_DELAY_S)) return false;
    if (this._retries === MAX_RETRIES) {
      this.minDelay = delay;
      return false;
    }
    this.heldBack += count;
    this._retries += 1;
    this._heldAt = now;
    return true;
  }

  /**
   * Whether a status tells that no newer image is to be waited for, so that the one held back may be shown.
   * @param {Status} status
   * @param {number} sequence of the newest image
   * @param {number} now
   * @returns {boolean}
   */
  noneNewer(status, sequence, now) {
    if (!this.heldBack) return false;
    return status.state !== "live" || (status.sequence === sequence && now - this._heldAt > NEWER_S);
  }

  /** The newest image may be painted. */
  release() {
    this.heldBack = this._delay = 0;
  }

  /** The newest image is on the screen. */
  painted() {
    this.heldBack = this._retries = 0;
    this._paintedDelay = this._delay;
  }
}
