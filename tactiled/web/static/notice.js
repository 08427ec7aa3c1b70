/** A message that disappears by itself. @module */

import { byId, setText } from "./dom.js";

const STAYS_MS = 3000;
const BAD_STAYS_MS = 8000;

let timer = 0;

/** @param {string} text @param {boolean} [bad] */
export function notice(text, bad = false) {
  const element = byId("notice");
  setText(element, text);
  element.hidden = false;
  element.classList.toggle("bad", bad);
  clearTimeout(timer);
  timer = setTimeout(() => { element.hidden = true; }, bad ? BAD_STAYS_MS : STAYS_MS);
}

/** @param {unknown} error @returns {string} */
export const messageOf = (error) => (error instanceof Error ? error.message : String(error));
