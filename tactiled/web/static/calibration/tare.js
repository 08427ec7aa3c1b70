/** Taring a sensor, and asking where it is loaded. @module */

import * as api from "../wire/api.js";
import { byId, setText } from "../shell/dom.js";
import { notice } from "../shell/notice.js";
import { withToken } from "../wire/token_dialog.js";

const LOOK_MS = 500; // between two looks whether a tare is complete
const MAX_LOOKS = 60;
const UNDO_MS = 600_000; // that the toolbar offers to undo a tare; step 1 of the calibration does so longer

const loaded = /** @type {HTMLDialogElement} */ (byId("loaded"));

/** @import { Calibration } from "../wire/api.js" */

/** @type {Map<string, number>} when this page completed a tare that can be undone, ms on performance.now's clock, by sensor */
const completed = new Map();

/** @param {string} name @returns {boolean} this page tared the sensor not long ago */
export const canUndo = (name) => performance.now() - (completed.get(name) ?? -Infinity) < UNDO_MS;

/** @param {string} name @param {(text: string, bad?: boolean) => void} [report] where to say it @returns {Promise<boolean>} it has begun */
export async function tare(name, report = notice) {
  if (!name) return false;
  let seen = "";
  const before = report === notice ? await api.calibration(name).catch(() => null) : null; // the dialog has its own undo
  const begin = (/** @type {boolean} */ force) => withToken(() => api.tare(name, force).catch((error) => {
    if (error.code !== "loaded") throw error;
    ({ seen } = error);
  }), "Tare failed", report);
  let begun = await begin(false);
  if (seen) begun = await confirmTare(name, seen) && await begin(true);
  if (begun) report("Tare: the next frames are taken as the unloaded array.");
  if (begun && before) offerUndo(name, before);
  return begun;
}

/**
 * Wait for a tare to be complete, and offer to undo it.
 * @param {string} name
 * @param {Calibration} before the tare
 */
async function offerUndo(name, before) {
  let now = before;
  for (let look = 0; now.tared_at === before.tared_at; look += 1) {
    if (look === MAX_LOOKS) return;
    await new Promise((resolve) => { setTimeout(resolve, LOOK_MS); });
    now = await api.calibration(name).catch(() => before);
  }
  completed.set(name, performance.now());
  notice(`${name}: tare complete.`, false, { name: "Undo", run: () => undoTare(name) });
}

/** @param {string} name @param {(text: string, bad?: boolean) => void} [report] where to say it */
export async function undoTare(name, report = notice) {
  if (await withToken(() => api.undoTare(name), "Not undone", report)) {
    completed.delete(name);
    report(`${name}: the zero before is back.`);
  }
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
