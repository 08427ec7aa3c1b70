/**
 * Which image may still be shown as the present: none that waited on its way, or for a page that stood still.
 * @module
 */

const OLDEST_S = 0.08; // behind the quickest on record, which was under way for some ms itself: no more than 0.1 in all
const DRIFT = 1e-3; // that the two clocks' rates may differ by

export class Present {
  /** @param {number} ahead images that may be under way at once */
  constructor(ahead) {
    /** Least of (arrival - sent), s: how far this browser's clock is ahead of the service's, and the quickest way. */
    this.least = Infinity;
    /** How many of the newest images are held back. */
    this.held = 0;
    this._ahead = ahead;
    this._at = 0;
    this._slow = false; // what was asked for after that was late, too
  }

  /**
   * An image came.
   * @param {number} sent Unix s, by the service's clock
   */
  hear(sent) {
    const at = Date.now() / 1000;
    const gone = Math.max(0, Math.min(1, at - this._at));
    this._at = at;
    this.least = Math.min(at - sent, this.least + DRIFT * gone);
  }

  /**
   * Whether images that came and were not shown yet have waited too long. No more are held back than may have been
   * under way before. If the next is late, too, then a clock was set, or all is slow: to wait on would show nothing newer.
   * @param {number} sent Unix s, of the newest of them
   * @param {number} count of them
   * @returns {boolean} they are held back: others are to be asked for
   */
  late(sent, count) {
    const way = Date.now() / 1000 - sent;
    const late = way - this.least > OLDEST_S;
    if (late && (this._slow || this.held + count > this._ahead)) {
      this._slow = true;
      this.least = way;
      return false;
    }
    this._slow = false;
    if (!late) return false;
    this.held += count;
    return true;
  }

  /** What came last is shown. */
  shown() {
    this.held = 0;
  }
}
