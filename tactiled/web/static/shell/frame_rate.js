/** How fast pictures come to the screen, and how old they are there. @module */

/** @import { Frame } from "../wire/frame_history.js" */

const MAX_CLOCK_OFFSET_S = 0.25; // that the browser's and the service's clocks may differ and still be compared
export const LATE_MS = 1000; // from a frame to the screen: from here on the page says so
const MAX_TIMES = 128; // paintings, more than a second's

/** @param {number} skew s @returns {boolean} it is more than clocks that may be compared have */
const doDiffer = (skew) => Number.isFinite(skew) && Math.abs(skew) > MAX_CLOCK_OFFSET_S;

/**
 * @param {number} timestamp Unix s by the service's clock, of a frame's first bus message
 * @param {number} skew s, the least of (arrival - sent)
 * @param {number} at Unix s by this browser's clock
 * @returns {number} ms from that message until then
 */
export const latencyOf = (timestamp, skew, at) => (at - timestamp - (doDiffer(skew) ? skew : 0)) * 1000;

export class FrameRate {
  constructor() {
    this.painted = 0;
    /** Of the newest picture, ms from the frame's first bus message to the screen. */
    this.latency = NaN;
    this._times = new Float64Array(MAX_TIMES).fill(-Infinity); // ms, a ring
    this._skew = Infinity; // s that this browser's clock is ahead of the service's, and the quickest way
  }

  /** Another sensor's pictures come from now on. */
  reset() {
    this.latency = NaN;
    this._skew = Infinity;
  }

  /**
   * A frame is on the screen for the first time.
   * @param {number} now ms, on performance.now's clock
   * @param {Frame} frame
   * @param {number} skew s, the least of (arrival - sent)
   */
  paint(now, frame, skew) {
    this._times[this.painted % MAX_TIMES] = now;
    this.painted += 1;
    const at = Date.now() / 1000;
    this._skew = skew;
    this.latency = latencyOf(frame.timestamp, skew, at);
  }

  /** @returns {boolean} the two clocks are too far apart to compare, and the way over the network is left out */
  get clocksDiffer() {
    return doDiffer(this._skew);
  }

  /** @returns {number} s that this browser's clock is off the service's; 0 where they agree */
  get skew() {
    return this.clocksDiffer ? this._skew : 0;
  }

  /** @returns {number} pictures painted in the last second */
  fps() {
    const since = performance.now() - 1000;
    let count = 0;
    for (let i = 0; i < MAX_TIMES; i += 1) if (this._times[i] > since) count += 1;
    return count;
  }
}
