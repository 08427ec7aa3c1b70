/** What the calibration page says: ways, instructions, results. @module */

import { duration, fixed, number } from "../shell/format.js";

/** @import { CalibrationSession, CoverResult, GainResult, Way } from "../wire/api.js" */

/** @typedef {"tare"|"gain"|"cover"} Step */

/**
 * @typedef {object} WayText
 * @property {Step} step that it belongs to
 * @property {string} title
 * @property {string} hint for choosing it
 * @property {string} instruction while frames are collected
 * @property {"pressure_kpa"|"weight_n"|null} mark what is entered meanwhile
 * @property {string} unit of that
 */

/** @type {Record<Way, WayText>} */
export const WAYS = {
  uniform: {
    step: "gain", title: "Even pressure", hint: "An air bag or a plenum presses all taxels alike. Scales every taxel, with its curve.",
    instruction: "Take 0 first. Then set a pressure, wait until it is steady, enter it and take it. Go up to the highest that you need; back down, too, if hysteresis matters.",
    mark: "pressure_kpa", unit: "kPa",
  },
  weight: {
    step: "gain", title: "Known weight", hint: "One weight, wholly on the array. One scale for all taxels.",
    instruction: "Take 0 first. Then put the weight on, wait until it is steady, enter its force (1 kg: 9.81 N) and take it. Lift it, take 0, and repeat elsewhere to be more exact.",
    mark: "weight_n", unit: "N",
  },
  tip: {
    step: "cover", title: "Round tip", hint: "A flat, round, hard tip, half a pitch to two pitches wide, pressed at about 20 places.",
    instruction: "Press the tip straight down for half a second, lift it, and press at another place.",
    mark: null, unit: "",
  },
  edge: {
    step: "cover", title: "Straight edge", hint: "A ridge, such as a ruler on its side, laid across the array at a slant five times.",
    instruction: "Lay it across the whole array at a slant, neither along rows nor columns. Press evenly for a second, lift it, turn it a little.",
    mark: null, unit: "",
  },
  blind: {
    step: "cover", title: "Anything", hint: "Use the skin for a minute: small and sharp contacts tell most. Least exact.",
    instruction: "Touch the array with small and sharp things, at ever other places.",
    mark: null, unit: "",
  },
};

/** What the demo does to the array that it simulates, by the way. @type {Record<Way, string>} */
export const DEMO = {
  uniform: "The demo sets 0, 20, 40, 60, 40 and 20 kPa for you, each for 8 s.",
  weight: "The demo has no weight: choose even pressure.",
  tip: "The demo presses for you, with a tip of 2 mm.",
  edge: "The demo lays a pad with one straight edge for you.",
  blind: "The demo touches the array for you.",
};

export const DEMO_UNLOADS = "The demo unloads its array for steps 2 and 3: go on with Next.";

/** What is measured of what presses: the field's label, the request's key, what an empty field means. */
export const SIZES = {
  tip: { label: "Diameter of its flat end", key: "tip_mm", empty: "Empty: it is fitted, too." },
  edge: { label: "Width of the ridge", key: "edge_mm", empty: "Empty: a soft pad with one edge." },
};

/** Rows of a result: name and unit, fitted, interval, before. @typedef {[string, string, string, string]} Row */

const between = (/** @type {[number, number]} */ [low, high], /** @type {(value: number) => string} */ text) => `${text(low)} to ${text(high)}`;

/** @param {CoverResult} cover @returns {Row[]} */
export const coverRows = (cover) => {
  const text = (/** @type {number} */ value) => fixed(value, 2);
  return [["thickness, mm", text(cover.thickness_mm), between(cover.interval_mm, text), text(cover.before_mm)]];
};

/** @param {GainResult} gain @returns {Row[]} */
export function gainRows(gain) {
  const digits = (/** @type {number} */ value) => Number(value.toPrecision(4)).toString().replace("-", "\u2212");
  const { before_kpa_per_count: before, interval_kpa_per_count: interval, spread_percent: spread, hysteresis_percent: hysteresis } = gain;
  /** @type {Row[]} */
  const rows = [["gain, kPa per count", digits(gain.kpa_per_count), interval ? between(interval, digits) : "unknown", before === null ? "none" : digits(before)]];
  if (spread !== null) rows.push(["spread over taxels, %", number(spread, 2), "", ""]);
  if (hysteresis !== null) rows.push(["hysteresis, % of full scale", number(hysteresis, 2), "", ""]);
  return rows;
}

/** @param {CalibrationSession} session that is fitted @returns {string} the result in a sentence */
export function verdict({ cover, gain }) {
  if (cover?.reason) return `This cannot tell the thickness: ${cover.reason.replace(/[^.?!]$/, "$&.")}`;
  if (cover) {
    const [low, high] = cover.interval_mm;
    const agrees = cover.before_mm >= low && cover.before_mm <= high;
    return agrees ? "The thickness agrees with the one before." : `The cover is ${cover.thickness_mm > cover.before_mm ? "thicker" : "thinner"} than the one before.`;
  }
  return gain ? `One count of the median taxel is ${Number(gain.kpa_per_count.toPrecision(3))} kPa, by a ${gain.form} curve.` : "";
}

const MADE_OF = { tip: "presses", edge: "edges", blind: "frames", uniform: "", weight: "" };

/** @param {CoverResult} cover @param {Way} way @returns {string[]} */
export function coverNotes({ presses, residual, reason, notes }, way) {
  if (reason) return notes;
  const check = residual === null ? "" : ` What it gives for ${MADE_OF[way]} that the fit did not use is off by ${number(residual)} times what noise and gain errors explain.`;
  return [`Fitted to ${presses} ${MADE_OF[way]}.${check}`, ...notes];
}

/** @param {number|null} age s @returns {string} */
export const tareText = (age) => (age === null ? "none since the start" : `${duration(age)} ago`);

const MAX_FAULTS = 3; // that are named

/**
 * @param {number[]} dead as configured
 * @param {{taxel: number, fault: string}[]} faults found while the sensor runs
 * @param {string|null} map what is wrong with the map of taxels; null: not known
 * @returns {string}
 */
export function taxelText(dead, faults, map) {
  const wrong = map && map !== "as configured" ? `wrong map: ${map}` : "";
  if (!dead.length && !faults.length) return wrong || "all work";
  const named = faults.slice(0, MAX_FAULTS).map((each) => `${each.taxel} ${each.fault}`);
  if (faults.length > MAX_FAULTS) named.push(`${faults.length - MAX_FAULTS} more`);
  if (dead.length) named.push(`${dead.length} configured as dead`);
  return `${dead.length + faults.length} left out: ${named.join(", ")}${wrong && `; ${wrong}`}`;
}

/**
 * What a zone shows: presses of those it needs.
 * @param {number} presses
 * @param {number} needed
 * @returns {{text: string, done: boolean}}
 */
export const zoneText = (presses, needed) =>
  presses >= needed ? { text: `✓ ${presses}`, done: true } : { text: `${presses} of ${needed}`, done: false };
