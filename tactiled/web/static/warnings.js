/**
 * Warnings, kept on the screen for a while after they were last told, so that nothing jumps where one comes and goes.
 * @module
 */

/** @typedef {import("./api.js").Warning} Warning */

const HOLD_MS = 3000;

export class Warnings {
  constructor() {
    /** @type {Map<string, {text: string, at: number}>} by code */
    this._held = new Map();
  }

  /** Hold nothing. */
  clear() {
    this._held.clear();
  }

  /**
   * @param {Warning[]} warnings now
   * @returns {string[]} texts of these and of those a little before, each in its newest numbers
   */
  hold(warnings) {
    const at = performance.now();
    for (const { code, text } of warnings) this._held.set(code, { text, at });
    for (const [each, last] of this._held) if (at - last.at > HOLD_MS) this._held.delete(each);
    return [...this._held.values()].map((each) => each.text);
  }
}
