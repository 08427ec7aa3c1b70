/** Light, dark, or as the system has it. @module */

import { keep, loadSetting } from "./storage.js";

const KEY = "tactiled.theme";
const NEXT = { system: "light", light: "dark", dark: "system" };
const TITLE = { system: "as the system", light: "light", dark: "dark" };

/**
 * Run the theme button.
 * @param {HTMLButtonElement} button
 * @param {() => void} onChange called after every change, the system's own included
 * @returns {() => void} takes the next theme
 */
export function theme(button, onChange) {
  /** @type {"system"|"light"|"dark"} */
  let now = "system";
  const show = () => {
    const root = document.documentElement;
    if (now === "system") delete root.dataset.theme;
    else root.dataset.theme = now;
    button.dataset.theme = now;
    button.setAttribute("aria-label", `Theme: ${TITLE[now]}. Change`);
    button.title = `Theme: ${TITLE[now]} (D)`;
    onChange();
  };
  const take = () => {
    now = /** @type {any} */ (NEXT[now]);
    keep(KEY, now);
    show();
  };
  const kept = loadSetting(KEY);
  if (kept === "light" || kept === "dark") now = kept;
  button.addEventListener("click", take);
  for (const query of ["(prefers-color-scheme: dark)", "(forced-colors: active)"]) {
    matchMedia(query).addEventListener("change", onChange);
  }
  show();
  return take;
}
