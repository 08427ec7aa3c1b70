/** Events as the rows of the log: what repeats is one row with its count. @module */

/** @import { Event } from "../wire/api.js" */

const MERGED_WITHIN_S = 600; // of the last time that a warning or a fault came or went
const MAX_ROWS = 100;
/** Kinds that come in pairs, by the first of the pair. @type {Record<string, string>} */
const BEGINS = {
  warning_cleared: "warning_raised", fault_cleared: "fault_raised", sensor_live: "sensor_stale", bus_up: "bus_down", region_below: "region_above",
};
const OF_STATE = new Set(["sensor_stale", "bus_down"]); // whose text differs from time to time

/**
 * @typedef {object} Row
 * @property {string} key of what repeats
 * @property {Event} event the newest
 * @property {number} since Unix s, of the first
 * @property {number} begun Unix s, of the newest that is no end of another
 * @property {number} count how often; a pair counts once
 */

/**
 * @param {Event} event
 * @param {string} kind of it, or of what began it
 * @returns {string} the same for what repeats; numbers in the text may differ
 */
function keyOf({ sensor, bus, text, warning }, kind) {
  const words = OF_STATE.has(kind) ? "" : kind === "region_above" ? text.split(":")[0] : text.replace(/\d+/g, "0");
  return [kind, sensor, bus, warning?.code ?? words].join();
}

/**
 * Add an event: to the newest row if it repeats that one, to the row of its warning or fault if that is recent.
 * @param {Row[]} rows newest first
 * @param {Event} event that is newer than they are
 */
export function addEvent(rows, event) {
  const ends = event.kind in BEGINS;
  const paired = ends || Object.values(BEGINS).includes(event.kind);
  const key = keyOf(event, BEGINS[event.kind] ?? event.kind);
  const at = rows.findIndex((each, i) => each.key === key && (paired ? event.time - each.event.time < MERGED_WITHIN_S : i === 0));
  const row = at < 0 ? { key: ends ? keyOf(event, event.kind) : key, event, since: event.time, begun: event.time, count: 0 } : rows.splice(at, 1)[0];
  row.event = event;
  if (!ends) row.begun = event.time;
  if (!ends || !row.count) row.count += 1;
  rows.unshift(row);
  rows.length = Math.min(rows.length, MAX_ROWS);
}
