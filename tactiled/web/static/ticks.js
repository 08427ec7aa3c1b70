/**
 * The ticks of a chart's axis, with their texts.
 * @module
 */

import { tickText, ticks } from "./scale.js";

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/**
 * @param {number} power
 * @returns {string} ten to that power
 */
function decade(power) {
  if (power === 0) return "1";
  if (power === -1) return "0.1";
  return `10${power < 0 ? "⁻" : ""}${SUPERSCRIPTS[Math.abs(power)]}`;
}

/** Made anew only where the axis has changed. */
export class Ticks {
  constructor() {
    /** @type {number[]} */
    this.values = [];
    /** @type {string[]} */
    this.texts = [];
    this._low = this._high = this._most = NaN;
  }

  /**
   * @param {number} low
   * @param {number} high
   * @param {number} most
   * @returns {boolean} they are as they were
   */
  _same(low, high, most) {
    if (low === this._low && high === this._high && most === this._most) return true;
    this._low = low;
    this._high = high;
    this._most = most;
    return false;
  }

  /**
   * @param {number} low
   * @param {number} high
   * @param {number} most how many at most, about
   * @returns {this}
   */
  even(low, high, most) {
    if (this._same(low, high, most)) return this;
    this.values = ticks(low, high, most);
    this.texts = this.values.map((each) => tickText(each, high - low));
    return this;
  }

  /**
   * @param {number} low power of ten
   * @param {number} high
   * @returns {this}
   */
  decades(low, high) {
    if (this._same(low, high, Infinity)) return this;
    this.values = Array.from({ length: Math.floor(high) - Math.ceil(low) + 1 }, (_, i) => Math.ceil(low) + i);
    this.texts = this.values.map(decade);
    return this;
  }
}
