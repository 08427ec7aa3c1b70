/** Warnings stay on the screen for a while, so that nothing jumps where one comes and goes. @module */

import { element, setText } from "./dom.js";

/** @import { Warning } from "../wire/api.js" */

const STAYS_MS = 5000; // after it was last reported, as the service's events have it
const QUIET = new Set(["cut_short", "noise_unknown"]); // a little less sharp, or just begun: no warning before it lasts, as in the service's events
const LASTS_MS = 10_000;
const GAP_MS = 1500; // longer than from status to status

export class Warnings {
  constructor() {
    /** @type {Map<string, {text: string, at: number}>} by code */
    this._recent = new Map();
    /** @type {Map<string, {since: number, at: number}>} ms, by code: since when and until when one was reported */
    this._quiet = new Map();
  }

  clear() {
    this._recent.clear();
    this._quiet.clear();
  }

  /**
   * @param {Warning[]} warnings of the newest image
   * @param {number} now ms
   * @returns {string[]} texts of these and of those reported shortly before, what only lasts at the end
   */
  hold(warnings, now) {
    for (const { code, text } of warnings) if (!QUIET.has(code) || this._lasts(code, now)) this._recent.set(code, { text, at: now });
    for (const [code, { at }] of this._recent) if (now - at > STAYS_MS) this._recent.delete(code);
    const recent = [...this._recent].sort(([one], [other]) => Number(QUIET.has(one)) - Number(QUIET.has(other)));
    return recent.map(([, { text }]) => text);
  }

  /** @param {string} code @param {number} now ms @returns {boolean} what is reported now was so for long */
  _lasts(code, now) {
    const before = this._quiet.get(code);
    const since = before && now - before.at < GAP_MS ? before.since : now;
    this._quiet.set(code, { since, at: now });
    return now - since >= LASTS_MS;
  }
}

/** The line of warnings under the page's head: always there, so that nothing moves when one comes. */
export class Alerts {
  /** @param {HTMLElement} root */
  constructor(root) {
    this._root = /** @type {HTMLDetailsElement} */ (root);
    this._summary = /** @type {HTMLElement} */ (root.querySelector("summary"));
    this._line = /** @type {HTMLElement} */ (this._summary.firstElementChild);
    this._list = /** @type {HTMLElement} */ (root.querySelector("ul"));
    this._recent = new Warnings();
    this._key = "";
  }

  /** Forget what was reported shortly before. */
  clear() {
    this._recent.clear();
  }

  /** @param {Warning[]|null} warnings of the newest image; null: not known @param {number} now ms */
  show(warnings, now) {
    const texts = this._recent.hold(warnings ?? [], now);
    const none = warnings ? "No warning" : "Warnings are not known";
    const key = [none, ...texts].join("\n");
    if (key === this._key) return;
    this._key = key;
    const count = texts.length;
    document.body.dataset.warnings = String(count);
    this._summary.tabIndex = count ? 0 : -1; // without a warning there is nothing to open
    setText(this._line, !count ? none : count === 1 ? texts[0] : `${count} warnings: ${texts[0]}`);
    this._list.replaceChildren(...texts.map((each) => element("li", "", each)));
    if (!count) this._root.open = false;
  }
}
