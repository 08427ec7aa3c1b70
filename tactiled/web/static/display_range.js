/** The pressure range that both maps share: fixed by hand, or following the data without flicker. @module */

const STEPS = [1, 1.5, 2, 3, 4, 5, 6, 8, 10];
const DECAY_S = 6; // the range forgets a peak over about this long
const HYSTERESIS = 0.85; // a smaller range is taken only once the data fill less than this much of it
const TIGHT = 0.71; // of a range, above which no smaller one is taken: HYSTERESIS times 5 over 6, the nearest two of STEPS
const LEAST_KPA = 1;
const NARROWEST = 1e-6; // of its larger end, what a range spans at least: ticks and colours are told apart

/** @param {number} value above 0 @returns {number} the least round number that is not below it */
export function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  for (let i = 0; i < STEPS.length; i += 1) if (STEPS[i] * power >= value * (1 - 1e-9)) return STEPS[i] * power;
  return 10 * power;
}

/**
 * Hold a range while the data fill it well, so that it does not flicker.
 * @param {number} top of the range, a round number; 0 for none yet
 * @param {number} most that it must hold, above 0
 * @returns {number} the top from now on
 */
export function hold(top, most) {
  if (most <= top && most > TIGHT * top) return top; // as nearly always: rounding makes garbage
  const wanted = roundUp(most);
  return wanted > top || roundUp(most / HYSTERESIS) < top ? wanted : top;
}

export class DisplayRange {
  /** @param {number} [least] that the range reaches up to where it follows the data */
  constructor(least = LEAST_KPA) {
    this.auto = true;
    this._least = least;
    /** Bottom and top of the range, kPa, or what else is shown on it. */
    this.low = 0;
    this.high = 10;
    this._peak = 0;
    this._time = 0;
  }

  /** Forget what was seen, as for another sensor; a fixed range stays. */
  reset() {
    this._peak = 0;
    this._time = 0;
    if (this.auto) this.high = 10;
  }

  /**
   * Follow a frame.
   * @param {number} peak kPa, the largest of both images
   * @param {number} noise kPa, of both images' noise the larger: noise alone never fills the range
   * @param {number} time s, of the frame
   */
  follow(peak, noise, time) {
    const gone = Math.min(1, Math.max(0, time - this._time));
    this._time = time;
    this._peak = Math.max(peak, this._least, 15 * noise, this._peak * Math.exp(-gone / DECAY_S));
    if (!this.auto) return;
    this.high = hold(this.high, this._peak);
  }

  /**
   * Fix the range.
   * @param {number} low kPa
   * @param {number} high kPa
   * @returns {string} why that is no range, with nothing changed; "" where it is one
   */
  fix(low, high) {
    const why = fault(low, high);
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
    this.high = roundUp(Math.max(this._peak, this._least));
  }
}

/** @param {number} low @param {number} high @returns {string} why that is no range; "" where it is one */
function fault(low, high) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return "a number is missing";
  if (high <= low) return "its end is not above its start";
  if (!Number.isFinite(high - low)) return "it is too wide";
  return high - low < NARROWEST * Math.max(Math.abs(low), Math.abs(high)) ? "it is too narrow" : "";
}
