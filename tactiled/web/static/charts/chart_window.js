/** The part of an axis that a chart shows: all of it, or what somebody zoomed to. @module */

const MIN_SHARE = 1e-3; // of all, that a window spans at least
const MIN_SPAN_S = 0.2;
const MAX_BACK_S = 600;
const FOLLOWS_SHARE = 0.05; // from its right end, within which zooming goes on following

export class AxisWindow {
  /** @param {() => void} onChange */
  constructor(onChange) {
    this._onChange = onChange;
    /** Ends of the axis, as the data have them. */
    this.low = 0;
    this.high = 1;
    this._left = NaN; // NaN: the window is all
    this._right = NaN;
  }

  /** @returns {boolean} a part is shown */
  get zoomed() {
    return !Number.isNaN(this._left);
  }

  /** @returns {number} */
  get left() {
    return this.zoomed ? this._left : this.low;
  }

  /** @returns {number} */
  get right() {
    return this.zoomed ? this._right : this.high;
  }

  /** Take other data: a part that is none of them any more ends. @param {number} low @param {number} high */
  limit(low, high) {
    if (low === this.low && high === this.high) return;
    this.low = low;
    this.high = high;
    if (this.zoomed) this._set(this._left, this._right);
  }

  /** Show all. */
  reset() {
    this._left = this._right = NaN;
    this._onChange();
  }

  /** @param {number} factor that the window becomes shorter by @param {number} [share] of it that stays where it is */
  zoom(factor, share = 0.5) {
    const span = Math.max((this.right - this.left) / factor, MIN_SHARE * (this.high - this.low));
    const at = this.left + share * (this.right - this.left);
    this._set(at - share * span, at + (1 - share) * span);
    this._onChange();
  }

  /** @param {number} share of the window, towards the right */
  pan(share) {
    const by = share * (this.right - this.left);
    this._set(this.left + by, this.right + by);
    this._onChange();
  }

  /** @param {number} left @param {number} right */
  _set(left, right) {
    const span = right - left;
    if (span >= this.high - this.low) {
      this._left = this._right = NaN;
      return;
    }
    this._left = Math.max(this.low, Math.min(this.high - span, left));
    this._right = this._left + span;
  }
}

/** The time axis that all live charts share: the last seconds, or a part of the last ten minutes that stays where it is. */
export class TimeWindow {
  /** @param {() => void} onChange */
  constructor(onChange) {
    this._onChange = onChange;
    /** s. */
    this.span = 10;
    this._end = NaN; // Unix s; NaN: it follows the newest frame
    this._newest = NaN;
  }

  /** @returns {boolean} it does not follow the newest frame */
  get zoomed() {
    return !Number.isNaN(this._end);
  }

  /** @param {number} newest Unix s, of the newest frame @returns {[number, number]} its ends, s from there */
  ends(newest) {
    this._newest = newest;
    const right = this.zoomed ? Math.max(this.span - MAX_BACK_S, Math.min(0, this._end - newest)) : 0;
    return [right - this.span, right];
  }

  /** Show the last seconds. @param {number} [span] */
  reset(span = 10) {
    this.span = span;
    this._end = NaN;
    this._onChange();
  }

  /** @param {number} factor @param {number} [share] of it that stays where it is: the right end while it follows */
  zoom(factor, share = this.zoomed ? 0.5 : 1) {
    const [left] = this.ends(this._newest);
    const span = Math.max(MIN_SPAN_S, Math.min(MAX_BACK_S, this.span / factor));
    const follows = !this.zoomed && share > 1 - FOLLOWS_SHARE;
    this._goTo(follows ? 0 : left + share * this.span + (1 - share) * span, span);
    this._onChange();
  }

  /** @param {number} share of the window, towards the right */
  pan(share) {
    this._goTo(this.ends(this._newest)[1] + share * this.span, this.span);
    this._onChange();
  }

  /** @param {number} right s from the newest frame @param {number} span s */
  _goTo(right, span) {
    this.span = span;
    this._end = right >= 0 ? NaN : this._newest + Math.max(right, span - MAX_BACK_S);
  }

  /** @returns {string} what it shows */
  get text() {
    const [left, right] = this.ends(this._newest);
    const round = (/** @type {number} */ s) => String(+(-s).toPrecision(2));
    return right === 0 || Number.isNaN(right) ? `last ${round(-this.span)} s` : `${round(left)} to ${round(right)} s ago`;
  }
}
