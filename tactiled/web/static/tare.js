/** Taring a sensor, and asking where it is loaded. @module */

import * as api from "./api.js";
import { byId, setText } from "./dom.js";
import { notice } from "./notice.js";
import { withToken } from "./token_dialog.js";

const loaded = /** @type {HTMLDialogElement} */ (byId("loaded"));

/** @param {string} name @param {typeof notice} [report] @returns {Promise<boolean>} it has begun */
export async function tare(name, report = notice) {
  if (!name) return false;
  let seen = "";
  const begin = (/** @type {boolean} */ force) => withToken(() => api.tare(name, force).catch((error) => {
    if (error.code !== "loaded") throw error;
    ({ seen } = error);
  }), "Tare failed", report);
  let begun = await begin(false);
  if (seen) begun = await confirmTare(name, seen) && await begin(true);
  if (begun) report("Tare: the next frames are taken as the unloaded array.");
  return begun;
}

/**
 * Show what a tare would take for zero, and ask.
 * @param {string} name
 * @param {string} seen
 * @returns {Promise<boolean>} to tare anyway
 */
async function confirmTare(name, seen) {
  setText(byId("loaded-seen"), `${name}: ${seen}.`);
  loaded.returnValue = "";
  loaded.showModal();
  await new Promise((resolve) => { loaded.addEventListener("close", resolve, { once: true }); });
  return loaded.returnValue === "force";
}
