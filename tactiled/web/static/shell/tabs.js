/** One tab a sensor, each with its state. @module */

import { byId, element, setText } from "./dom.js";
import { isBrowsers } from "./keyboard.js";

/** @import { Sensor } from "../wire/api.js" */

/** What stands for all sensors at once, where a sensor's name is meant: none is called so. */
export const ALL = "";

const BESIDE_PX = 24; // of the next tab, shown beside one that was scrolled to

export class Tabs {
  /** @param {(name: string) => void} onChoose */
  constructor(onChoose) {
    this._onChoose = onChoose;
    this._list = byId("tabs");
    /** @type {Map<string, HTMLButtonElement>} */
    this._tabs = new Map();
    this._list.addEventListener("keydown", (event) => this._move(event));
  }

  /** @returns {string[]} of the sensors */
  get names() {
    return [...this._tabs.keys()].filter((each) => each !== ALL);
  }

  /** @param {Sensor[]} sensors */
  update(sensors) {
    const names = sensors.map((each) => each.name);
    if (names.join("\n") !== this.names.join("\n")) this._build(names);
    for (const sensor of sensors) this.mark(sensor.name, sensor.state);
  }

  /** @param {string} name @param {string} state */
  mark(name, state) {
    const tab = this._tabs.get(name);
    if (!tab || tab.dataset.state === state) return;
    tab.dataset.state = state;
    setText(/** @type {Element} */ (tab.lastElementChild), state === "live" ? "" : state);
  }

  /** @param {string} name */
  choose(name) {
    const was = this._list.querySelector('[aria-selected="true"]');
    for (const [each, tab] of this._tabs) {
      tab.setAttribute("aria-selected", String(each === name));
      tab.tabIndex = each === name ? 0 : -1;
    }
    const tab = this._tabs.get(name);
    if (tab && tab !== was) this._reveal(tab);
  }

  /** Scroll the row of tabs, and nothing else, until one is seen whole. @param {HTMLElement} tab */
  _reveal(tab) {
    const all = this._list.getBoundingClientRect();
    const one = tab.getBoundingClientRect();
    if (one.right > all.right) this._list.scrollLeft += one.right - all.right + BESIDE_PX;
    else if (one.left < all.left) this._list.scrollLeft -= all.left - one.left + BESIDE_PX;
  }

  /** @param {string[]} names */
  _build(names) {
    this._tabs.clear();
    this._list.replaceChildren();
    for (const name of names.length > 1 ? [ALL, ...names] : names) {
      const tab = element("button", "", element("span", "", name === ALL ? "All" : name));
      tab.type = "button";
      tab.setAttribute("role", "tab");
      tab.setAttribute("aria-controls", name === ALL ? "wall" : "main");
      tab.setAttribute("aria-selected", "false");
      if (name === ALL) tab.title = "All sensors at once (W)";
      else {
        const dot = element("span", "dot");
        dot.setAttribute("aria-hidden", "true");
        tab.prepend(dot);
        tab.append(element("span", "sub"));
      }
      tab.addEventListener("click", () => this._onChoose(name));
      this._tabs.set(name, tab);
      this._list.append(tab);
    }
  }

  /** @param {KeyboardEvent} event */
  _move(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const names = [...this._tabs.keys()];
    const now = names.findIndex((each) => this._tabs.get(each) === document.activeElement);
    if (!step || now < 0 || names.length < 2 || isBrowsers(event)) return;
    event.stopPropagation();
    event.preventDefault();
    const next = names[(now + step + names.length) % names.length];
    this._onChoose(next);
    this._tabs.get(next)?.focus();
  }
}
