/** A message that disappears by itself. @module */

import { byId, element } from "./dom.js";

const STAYS_MS = 3000;
const BAD_STAYS_MS = 8000; // also what offers something

let timer = 0;

/**
 * @param {string} text
 * @param {boolean} [bad]
 * @param {{name: string, run: () => void}|null} [action] a button for it
 */
export function notice(text, bad = false, action = null) {
  const box = byId("notice");
  const open = document.activeElement?.closest("dialog:modal") ?? document.querySelector("dialog:modal");
  (open ?? document.body).append(box); // what is beside an open dialog is out of reach
  box.replaceChildren(text);
  if (action) {
    const button = element("button", "", action.name);
    button.type = "button";
    button.addEventListener("click", action.run);
    box.append(" ", button);
  }
  box.hidden = false;
  box.classList.toggle("bad", bad);
  clearTimeout(timer);
  timer = setTimeout(() => { box.hidden = true; }, bad || action ? BAD_STAYS_MS : STAYS_MS);
}

/** Take a message away that is of use no more. @param {string} text */
export function withdraw(text) {
  const box = byId("notice");
  if (box.textContent === text) box.hidden = true;
}

/** @param {unknown} error @returns {string} */
export const messageOf = (error) => (error instanceof Error ? error.message : String(error));
