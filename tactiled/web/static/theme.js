/**
 * Light, dark, or as the system has it.
 * @module
 */

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
    try {
      localStorage.setItem(KEY, now);
    } catch {
      // A browser that keeps nothing still shows the theme.
    }
    show();
  };
  try {
    const kept = localStorage.getItem(KEY);
    if (kept === "light" || kept === "dark") now = kept;
  } catch {
    // As above.
  }
  button.addEventListener("click", take);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", onChange);
  show();
  return take;
}
