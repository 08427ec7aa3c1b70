/**
 * Which image may still be shown as the present: none that waited on its way, or for a page that stood still.
 * @module
 */

const OLDEST_S = 0.08; // behind the quickest on record, which was under way for some ms itself: no more than 0.1 in all
const DRIFT = 1e-3; // that the two clocks' rates may differ by
const ROUNDS = 4; // between two paintings that are held back and asked for anew: what is late then is painted

export class Freshness {
  constructor() {
    /** Least of (arrival - sent), s: how far this browser's clock is ahead of the service's, and the quickest way. */
    this.least = Infinity;
    /** How many of the newest images are held back. */
    this.held = 0;
    this._at = 0;
    this._late = 0; // s, of the newest that was looked at
    this._before = 0; // s, of the one that was painted last: on a slow page the next is as late, whatever is waited for
    this._rounds = 0; // since then
  }

  /** An image came. @param {number} sent Unix s, by the service's clock */
  hear(sent) {
    const at = Date.now() / 1000;
    const gone = Math.max(0, Math.min(1, at - this._at));
    this._at = at;
    this.least = Math.min(at - sent, this.least + DRIFT * gone);
  }

  /**
   * Whether images that came and were not painted yet have waited too long. If all that are asked for in their place are
   * late, too, then a clock was set, or all is slow: to wait on would show nothing newer.
   * @param {number} sent Unix s, of the newest of them
   * @param {number} count of them
   * @returns {boolean} they are held back: others are to be asked for
   */
  late(sent, count) {
    const way = Date.now() / 1000 - sent;
    this._late = way - this.least;
    if (this._late <= (this._before > OLDEST_S ? 2 * this._before : OLDEST_S)) return false;
    if (this._rounds === ROUNDS) {
      this.least = way;
      return false;
    }
    this.held += count;
    this._rounds += 1;
    return true;
  }

  /** What came last may be shown. */
  shown() {
    this.held = this._late = 0;
  }

  /** What came last is on the screen. */
  painted() {
    this.held = this._rounds = 0;
    this._before = this._late;
  }
}
