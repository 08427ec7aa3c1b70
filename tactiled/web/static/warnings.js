/**
 * Warnings, kept on the screen for a while after they were last told, so that nothing jumps where one comes and goes.
 * @module
 */

const HOLD_MS = 3000;

export class Warnings {
  constructor() {
    /** @type {Map<string, {text: string, at: number}>} */
    this._held = new Map();
  }

  /** Hold nothing. */
  clear() {
    this._held.clear();
  }

  /**
   * @param {string[]} told now
   * @returns {string[]} these and what was told a little before, each in its newest numbers
   */
  hold(told) {
    const at = performance.now();
    for (const text of told) this._held.set(kind(text), { text, at });
    for (const [each, last] of this._held) if (at - last.at > HOLD_MS) this._held.delete(each);
    return [...this._held.values()].map((each) => each.text);
  }
}

/**
 * @param {string} text
 * @returns {string} the same for warnings that differ in their numbers only
 */
const kind = (text) =>
  text.replaceAll(/\d[\d.]*(e[-+]?\d+)?/g, "#").replaceAll("taxels", "taxel").replaceAll("their", "its");
