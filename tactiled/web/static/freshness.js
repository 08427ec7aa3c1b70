/**
 * Which image may still be shown as the present: none that waited on its way, or for a page that stood still.
 * @module
 */

const MAX_DELAY_S = 0.08; // behind the quickest on record, which was under way for some ms itself: no more than 0.1 in all
const CLOCK_DRIFT = 1e-3; // that the two clocks' rates may differ by
const MAX_RETRIES = 4; // between two paintings that are held back and asked for anew: what is late then is painted

export class Freshness {
  constructor() {
    /** Least of (arrival - sent), s: how far this browser's clock is ahead of the service's, and the quickest way. */
    this.minDelay = Infinity;
    /** How many of the newest images are held back. */
    this.heldBack = 0;
    this._arrivedAt = 0;
    this._delay = 0; // s, of the newest that was looked at
    this._paintedDelay = 0; // s, of the one that was painted last: on a slow page the next is as late, whatever is waited for
    this._retries = 0; // since then
  }

  /** An image came. @param {number} sent Unix s, by the service's clock */
  arrived(sent) {
    const at = Date.now() / 1000;
    const elapsed = Math.max(0, Math.min(1, at - this._arrivedAt));
    this._arrivedAt = at;
    this.minDelay = Math.min(at - sent, this.minDelay + CLOCK_DRIFT * elapsed);
  }

  /**
   * Whether images that came and were not painted yet have waited too long. If all that are asked for in their place are
   * late, too, then a clock was set, or all is slow: to wait on would show nothing newer.
   * @param {number} sent Unix s, of the newest of them
   * @param {number} count of them
   * @returns {boolean} they are held back: others are to be asked for
   */
  holdBack(sent, count) {
    const way = Date.now() / 1000 - sent;
    this._delay = way - this.minDelay;
    if (this._delay <= (this._paintedDelay > MAX_DELAY_S ? 2 * this._paintedDelay : MAX_DELAY_S)) return false;
    if (this._retries === MAX_RETRIES) {
      this.minDelay = way;
      return false;
    }
    this.heldBack += count;
    this._retries += 1;
    return true;
  }

  /** What came last may be shown. */
  shown() {
    this.heldBack = this._delay = 0;
  }

  /** What came last is on the screen. */
  painted() {
    this.heldBack = this._retries = 0;
    this._paintedDelay = this._delay;
  }
}
