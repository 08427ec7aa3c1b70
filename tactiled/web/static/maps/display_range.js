/** The pressure range that both maps share: fixed by hand, or following the data without flicker. @module */

const STEPS = [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10];
const FALL_S = 10; // the range rises at once and falls by a tenth of the distance a second,
const LOW = 0.4; // or at once where a press fills less than this of what the range holds (a quarter of the range, as that
const LIFT_S = 0.2; // stays down to HYSTERESIS times 3 over 4 of itself) for longer than this: lifting takes a moment
const HYSTERESIS = 0.85; // a smaller range is taken only once the data fill less than this much of it
const KEEP_ABOVE = 0.709; // of a range, above which no smaller one is taken: HYSTERESIS times 2.5 over 3, the nearest two of STEPS
const MIN_TOP = 1; // kPa, or counts
const BELOW_ZERO = { deviations: 5, share: 0.02 }; // of the noise, and of the range's top: what is further below zero is marked
const MIN_RELATIVE_SPAN = 1e-6; // of its larger end, what a range spans at least: ticks and colours must differ

/** @param {number} value above 0 @returns {number} the least round number that is not below it */
export function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  for (let i = 0; i < STEPS.length; i += 1) if (STEPS[i] * power >= value * (1 - 1e-9)) return STEPS[i] * power;
  return 10 * power;
}

/**
 * Hold a range while the data fill it well, so that it does not flicker.
 * @param {number} top of the range, a round number; 0 for none yet
 * @param {number} needed that it must hold, above 0
 * @returns {number} the top from now on
 */
export function steadyTop(top, needed) {
  if (needed <= top && needed > KEEP_ABOVE * top) return top; // as nearly always: rounding makes garbage
  const rounded = roundUp(needed);
  return rounded > top || roundUp(needed / HYSTERESIS) < top ? rounded : top;
}

export class DisplayRange {
  /** @param {number} [minTop] that the range reaches up to where it follows the data */
  constructor(minTop = MIN_TOP) {
    this.auto = true;
    this._minTop = minTop;
    /** Bottom and top of the range, in its unit, or what else is shown on it. */
    this.low = 0;
    this.high = 10;
    /** Below this, a value is clearly below zero, as no pressure is. */
    this.floor = 0;
    this._peak = 0;
    this._time = 0;
    this._held = 0; // s: when a press last filled enough of it, or nothing pressed
  }

  /** Forget what was seen, as for another sensor; a fixed range stays. */
  reset() {
    this._peak = 0;
    this._time = 0;
    if (this.auto) this.high = 10;
  }

  /**
   * Follow a frame.
   * @param {number} peak the largest of both images
   * @param {number} noise of both images' noise the larger: noise alone never fills the range
   * @param {number} time s, of the frame
   */
  follow(peak, noise, time) {
    const elapsed = Math.min(1, Math.max(0, time - this._time));
    this._time = time;
    const least = Math.max(this._minTop, 15 * noise);
    const needed = Math.max(peak, least);
    this._peak = Math.max(needed, needed + (this._peak - needed) * Math.exp(-elapsed / FALL_S));
    if (peak <= least || peak >= LOW * this._peak || time < this._held) this._held = time;
    else if (time - this._held > LIFT_S) this._peak = peak / LOW;
    if (this.auto) this.high = steadyTop(this.high, this._peak);
    this._setFloor(noise);
  }

  /** Take the range of one frame alone, as of one that is paused. @param {number} peak @param {number} noise as in `follow` */
  show(peak, noise) {
    this._peak = Math.max(peak, this._minTop, 15 * noise);
    if (this.auto) this.high = roundUp(this._peak);
    this._setFloor(noise);
  }

  /** @param {number} noise */
  _setFloor(noise) {
    this.floor = -Math.max(BELOW_ZERO.deviations * noise, BELOW_ZERO.share * this.high);
  }

  /**
   * Fix the range.
   * @param {number} low
   * @param {number} high
   * @returns {string} why that is no range, with nothing changed; "" where it is one
   */
  fix(low, high) {
    const why = rangeError(low, high);
    if (why) return why;
    this.auto = false;
    this.low = low;
    this.high = high;
    return "";
  }

  /** Follow the data again. */
  release() {
    this.auto = true;
    this.low = 0;
    this.high = roundUp(Math.max(this._peak, this._minTop));
  }
}

/** @param {number} low @param {number} high @returns {string} why that is no range; "" where it is one */
function rangeError(low, high) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return "A number is missing";
  if (high <= low) return "The maximum must exceed the minimum";
  if (!Number.isFinite(high - low)) return "The numbers are too far apart";
  return high - low < MIN_RELATIVE_SPAN * Math.max(Math.abs(low), Math.abs(high)) ? "The numbers are too close together" : "";
}
