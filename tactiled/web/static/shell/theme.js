/** Light, dark, or as the system has it. @module */

import { saveSetting, loadSetting } from "./storage.js";

const KEY = "tactiled.theme";
const TITLE = { system: "as the system", light: "light", dark: "dark" };

const prefersDark = () => matchMedia("(prefers-color-scheme: dark)").matches;

/** @returns {boolean} the page is dark now */
export function isDark() {
  const { theme: chosen } = document.documentElement.dataset;
  return chosen ? chosen === "dark" : prefersDark();
}

/**
 * Run the theme button.
 * @param {HTMLButtonElement} button
 * @param {() => void} onChange called after every change, the system's own included
 * @returns {() => void} takes the next theme
 */
export function theme(button, onChange) {
  /** @type {"system"|"light"|"dark"} */
  let current = "system";
  const show = () => {
    const root = document.documentElement;
    if (current === "system") delete root.dataset.theme;
    else root.dataset.theme = current;
    button.dataset.theme = current;
    button.setAttribute("aria-label", `Theme: ${TITLE[current]}. Change`);
    button.title = `Theme: ${TITLE[current]} (D)`;
    onChange();
  };
  const next = () => {
    const systems = prefersDark() ? "dark" : "light";
    const other = prefersDark() ? "light" : "dark";
    current = /** @type {const} */ ({ system: other, [other]: systems, [systems]: "system" })[current];
    saveSetting(KEY, current);
    show();
  };
  const saved = loadSetting(KEY);
  if (saved === "light" || saved === "dark") current = saved;
  button.addEventListener("click", next);
  for (const query of ["(prefers-color-scheme: dark)", "(forced-colors: active)"]) {
    matchMedia(query).addEventListener("change", onChange);
  }
  show();
  return next;
}
