/** Files for the browser to save. @module */

/** @import { Frame } from "../wire/frame_history.js" */

/** @param {number} timestamp Unix s */
export const isoTime = (timestamp) => new Date(timestamp * 1000).toISOString();

/**
 * Save a file named after the sensor and the frame.
 * @param {string} sensor
 * @param {Frame} frame
 * @param {string} suffix
 * @param {Blob} blob
 */
export function download(sensor, frame, suffix, blob) {
  const url = URL.createObjectURL(blob);
  const link = document.createElement("a");
  link.href = url;
  link.download = `${sensor.replace(/[^\w-]+/g, "_")}-${frame.sequence}.${suffix}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
