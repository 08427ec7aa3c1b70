/** Keyboard shortcuts. @module */

import { saveSetting, loadSetting } from "./storage.js";

const KEY = "tactiled.keys";
const TYPED_IN = "input:not([type=checkbox], [type=range]), select, textarea";
const OWN_ARROWS = "#split"; // those of the slider for kept frames do the same

/** @param {KeyboardEvent} event @returns {boolean} a shortcut of the browser's: back, to the top of the page, ... */
export const isBrowsers = ({ altKey, ctrlKey, metaKey }) => altKey || ctrlKey || metaKey;

/**
 * Call an action for each key that names one; keys meant for a field, a button, a dialog or the browser stay theirs.
 * @param {Record<string, (event: KeyboardEvent) => unknown>} actions by `event.key`, letters in lower case, behind "Alt+"
 *   where that is pressed; one that returns false leaves its key to the browser
 * @param {HTMLInputElement} on box that is checked where keys of one character act; the browser keeps it so
 */
export function listenForKeys(actions, on) {
  on.checked = loadSetting(KEY) !== "off";
  on.addEventListener("change", () => saveSetting(KEY, on.checked ? "on" : "off"));
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || document.querySelector("dialog[open]")) return;
    const target = event.target instanceof HTMLElement ? event.target : null;
    if (event.key.length === 1 && !on.checked) return;
    if (target?.closest(TYPED_IN)) {
      if (event.key === "Escape") target.blur(); // or the next letter would choose in a list of methods
      return;
    }
    if (event.key === " " && target?.closest("button, [type=checkbox], a")) return;
    if (event.key.startsWith("Arrow") && target?.closest(OWN_ARROWS)) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const action = actions[event.altKey ? `Alt+${key}` : key];
    if (action && action(event) !== false) event.preventDefault();
  });
  // A button keeps the focus of a click: give it back, or the next space would press the button again.
  document.addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (button && event.detail > 0 && !button.closest("dialog")) button.blur();
  });
}
