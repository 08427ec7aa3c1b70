/** What a saved frame says of itself: where it is from, how it was made, and what is wrong with it. @module */

import { isoTime } from "./download.js";
import { timeOffset } from "../shell/timeline.js";
import { UNITS } from "../shell/units.js";

/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Status } from "../wire/sensor_stream.js" */

/**
 * @param {string} sensor
 * @param {Frame} frame
 * @param {Status|null} status of the frame, or of one near it
 * @param {string} state what the page says of the picture: live, stale, ...
 * @returns {[string, string][]} name and value, the most important first
 */
export function provenance(sensor, frame, status, state) {
  const offset = status ? timeOffset(status, frame) : "";
  const warnings = status?.warnings.map((each) => each.text).join("; ");
  return [
    ["sensor", sensor],
    ["frame", String(frame.sequence)],
    ["time", isoTime(frame.timestamp)],
    ["state", state],
    ["method", frame.method || "unknown"],
    ["unit", UNITS[frame.unit]],
    ["calibration", status?.calibration ?? "not reported"],
    [offset ? `warnings from ${offset}` : "warnings", warnings ?? "not reported"],
  ].map(([name, value]) => [name, value || "none"]);
}
