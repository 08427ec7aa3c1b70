/** Actions that need the control token, and the dialog for it. @module */

import { ApiError, showToken } from "./api.js";
import { byId, setText } from "../shell/dom.js";
import { messageOf, notice } from "../shell/notice.js";

/**
 * Do something; where the service wants a token for it, ask for one and do it again.
 * @param {() => Promise<unknown>} action
 * @param {string} failed what to say where it fails
 * @param {(text: string, bad: boolean) => void} [report] where to say it: a dialog hides the notice
 * @returns {Promise<boolean>} it was done
 */
export async function withToken(action, failed, report = notice) {
  for (;;) {
    try {
      await action();
      return true;
    } catch (error) {
      const refused = error instanceof ApiError && (error.status === 401 || error.status === 403);
      if (refused && await askForToken(error.message)) continue;
      report(`${failed}: ${messageOf(error)}`, true);
      return false;
    }
  }
}

/**
 * Ask for a token until the service knows it.
 * @param {string} why
 * @returns {Promise<boolean>} false where none was given
 */
async function askForToken(why) {
  for (let text = why; ; ) {
    const token = await readToken(text);
    if (!token) return false;
    try {
      await showToken(token);
      return true;
    } catch (error) {
      text = messageOf(error);
    }
  }
}

/** @param {string} why @returns {Promise<string>} what was typed; "" where the dialog was left */
function readToken(why) {
  const dialog = /** @type {HTMLDialogElement} */ (byId("token"));
  const field = /** @type {HTMLInputElement} */ (byId("token-field"));
  setText(byId("token-why"), why);
  field.value = "";
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "use" ? field.value : ""), { once: true });
  });
}
