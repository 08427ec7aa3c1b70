/** Warnings stay on the screen for a while, so that nothing jumps where one comes and goes. @module */

/** @import { Warning } from "./api.js" */

const STAYS_MS = 3000; // after it was last reported

export class Warnings {
  constructor() {
    /** @type {Map<string, {text: string, at: number}>} by code */
    this._recent = new Map();
  }

  clear() {
    this._recent.clear();
  }

  /**
   * @param {Warning[]} warnings of the newest image
   * @param {number} now ms
   * @returns {string[]} texts of these and of those reported shortly before
   */
  hold(warnings, now) {
    for (const { code, text } of warnings) this._recent.set(code, { text, at: now });
    for (const [code, { at }] of this._recent) if (now - at > STAYS_MS) this._recent.delete(code);
    return [...this._recent.values()].map((each) => each.text);
  }
}
