/** Whether what is on the screen is the present, and the text for it where it is not. @module */

import { duration } from "./format.js";

/** @import { Status } from "../wire/sensor_stream.js" */
/** @import { ReconnectingSocket } from "../wire/socket.js" */

/** @typedef {{lastMessageAt: number, requestedAt: number}} Replies of a sensor: `requestedAt` 0 if no image is due */

/**
 * @typedef {object} Health
 * @property {"live"|"connecting"|"disconnected"|"down"|"silent"|"stale"|"ended"|"playback"} level
 * @property {string} title
 * @property {string} text
 */

/** @type {Health} */
export const CONNECTING = { level: "connecting", title: "CONNECTING", text: "" };
const STALLED_AFTER_S = 2; // no image for so long, though the sensor is live
const OVERDUE_MS = 2500; // of the service's once-a-second word

/**
 * Times are ms on performance.now's clock.
 * @param {Pick<ReconnectingSocket, "link"|"reason"|"retryAt"|"attempts">} socket
 * @param {Replies} replies
 * @param {Status|null} status the newest
 * @param {number} statusAt when that came
 * @param {number} imageAt when the newest image came; 0 before the first
 * @param {number} now
 * @returns {Health}
 */
export function healthOf(socket, replies, status, statusAt, imageAt, now) {
  const age = ageOf(status, statusAt, now);
  const lastFrame = age === null ? "No frame yet." : `Last frame ${duration(age)} ago.`;
  if (!status && socket.link !== "closed" && !socket.attempts) return CONNECTING;
  if (socket.link !== "open") {
    const wait = Math.max(0, (socket.retryAt - now) / 1000);
    const then = socket.link === "connecting" ? "Retrying now." : `Retrying in ${Math.ceil(wait)} s.`;
    const why = socket.reason ? ` (${socket.reason})` : "";
    return { level: "disconnected", title: "DISCONNECTED", text: `${then} ${lastFrame}${why}` };
  }
  if (now - replies.lastMessageAt > OVERDUE_MS) {
    return { level: "disconnected", title: "NO ANSWER", text: `No message for ${duration((now - replies.lastMessageAt) / 1000)}. ${lastFrame}` };
  }
  if (!status) return CONNECTING;
  if (status.state === "ended") return { level: "ended", title: "", text: `${status.detail}.` };
  if (status.state === "down") {
    const title = status.position_s === null ? "BUS DOWN" : "REPLAY FAILED";
    return { level: "down", title, text: `${status.detail}. ${lastFrame}` };
  }
  if (status.state === "silent") return { level: "silent", title: "SILENT", text: `${status.detail}. Check its power, its wiring, the bit rate and its CAN id.` };
  if (status.state === "stale") {
    const more = status.detail.startsWith("no frame") ? "" : ` ${status.detail}`;
    return { level: "stale", title: "STALE", text: `last frame ${duration(age ?? 0)} ago.${more}` };
  }
  const stalled = replies.requestedAt ? (now - replies.requestedAt) / 1000 : 0;
  if (stalled > Math.max(STALLED_AFTER_S, status.rate_hz > 0 ? 3 / status.rate_hz : 0)) {
    return { level: "stale", title: "STALE", text: `last image ${duration((now - (imageAt || replies.requestedAt)) / 1000)} ago, though frames come in.` };
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
