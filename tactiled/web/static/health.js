/** Whether what is on the screen is the present, and the words for it where it is not. @module */

import { fixed } from "./format.js";

/** @import { Status } from "./sensor_stream.js" */

/**
 * How the way to the service is doing; times in ms on performance.now's clock.
 * @typedef {object} StreamState
 * @property {"connecting"|"open"|"closed"} link
 * @property {string} reason why it closed
 * @property {number} retryAt
 * @property {number} attempts
 * @property {number} heardAt
 * @property {number} requestedAt when an image was asked for that has not come yet; 0 where none was
 */

/**
 * @typedef {object} Health
 * @property {"live"|"connecting"|"disconnected"|"down"|"silent"|"stale"} level
 * @property {string} title
 * @property {string} text
 */

const STALLED_AFTER_S = 2; // no image for so long, though the sensor is said to be live
const OVERDUE_MS = 2500; // of the service's once-a-second word

/**
 * @param {StreamState|null} stream
 * @param {Status|null} status the newest
 * @param {number} statusAt when that came, ms on performance.now's clock
 * @param {number} imageAt when the newest pair came; 0 before the first
 * @returns {Health}
 */
export function healthOf(stream, status, statusAt, imageAt) {
  const now = performance.now();
  const age = ageOf(status, statusAt, now);
  const lastFrame = age === null ? "No frame yet." : `Last frame ${duration(age)} ago.`;
  if (!stream || (!status && stream.link !== "closed" && !stream.attempts)) {
    return { level: "connecting", title: "CONNECTING", text: "" };
  }
  if (stream.link !== "open") {
    const wait = Math.max(0, (stream.retryAt - now) / 1000);
    const then = stream.link === "connecting" ? "Retrying now." : `Retrying in ${Math.ceil(wait)} s.`;
    const why = stream.reason ? ` (${stream.reason})` : "";
    return { level: "disconnected", title: "DISCONNECTED", text: `${then} ${lastFrame}${why}` };
  }
  if (now - stream.heardAt > OVERDUE_MS) {
    return { level: "disconnected", title: "NO ANSWER", text: `Nothing heard for ${duration((now - stream.heardAt) / 1000)}. ${lastFrame}` };
  }
  if (!status) return { level: "connecting", title: "CONNECTING", text: "" };
  if (status.state === "down") return { level: "down", title: "BUS DOWN", text: `${status.detail}. ${lastFrame}` };
  if (status.state === "silent") return { level: "silent", title: "SILENT", text: `${status.detail}.` };
  if (status.state === "stale") {
    const more = status.detail.startsWith("no frame") ? "" : ` ${status.detail}`;
    return { level: "stale", title: "STALE", text: `last frame ${duration(age ?? 0)} ago.${more}` };
  }
  const stalled = stream.requestedAt ? (now - stream.requestedAt) / 1000 : 0;
  if (stalled > Math.max(STALLED_AFTER_S, status.rate_hz > 0 ? 3 / status.rate_hz : 0)) {
    return { level: "stale", title: "STALE", text: `last image ${duration((now - (imageAt || stream.requestedAt)) / 1000)} ago, though frames come in.` };
  }
  return { level: "live", title: "", text: "" };
}

/**
 * @param {Status|null} status
 * @param {number} statusAt ms
 * @param {number} now ms
 * @returns {number|null} s since the sensor's last frame; null before the first
 */
function ageOf(status, statusAt, now) {
  if (!status || status.age_s === null) return null;
  return status.age_s + (now - statusAt) / 1000;
}

/** @param {number} seconds @returns {string} */
function duration(seconds) {
  if (seconds < 100) return `${fixed(seconds, 1)} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  return `${Math.floor(seconds / 3600)} h`;
}
