/**
 * Quantities as text, each with its unit; the service's units are in `tactiled/units.py`. That of pressure, and with it
 * that of force, follows the calibration of the sensor: it is an index in UNITS.
 * @module
 */

import { fixed, newtons, number, whole } from "./format.js";

/** Units of pressure by their number in a message; counts where the sensor is uncalibrated. */
export const UNITS = ["kPa", "counts"];
export const FORCE_UNITS = ["N", "counts·mm²"];
export const FORCE_SCALES = [1e-3, 1]; // force of a pressure of 1 on 1 mm²

/** @param {import("../wire/api.js").Measure} quantity @param {number} unit of pressure @returns {string} that of the quantity */
export const unitOfQuantity = (quantity, unit) => ({ force: FORCE_UNITS[unit], mean: UNITS[unit], peak: UNITS[unit], area: "mm²" })[quantity];

/** @param {string} name as the service's JSON has it @returns {number} index in UNITS */
export const unitOf = (name) => Math.max(0, UNITS.indexOf(name));

/** @param {number} value @param {number} unit @param {number} digits significant ones @returns {string} */
export const pressureText = (value, unit, digits = 3) => `${number(value, digits)} ${UNITS[unit]}`;

/** @param {number} value mm @returns {string} with three significant digits, two decimals at most; without its unit */
export const lengthNumber = (value) => (Math.abs(value) < 1 ? fixed(value, 2) : number(value));

/** @param {number} value mm @returns {string} */
export const lengthText = (value) => `${lengthNumber(value)} mm`;

/** @param {number} value @param {number} unit of pressure @returns {string} without its unit */
export const forceNumber = (value, unit) => (unit ? whole(value) : newtons(value));

/** @param {number} value of a deviation @param {number} unit of pressure @returns {string} two significant digits, five decimals at most, as a force; without its unit */
export const forceSpread = (value, unit) =>
  unit || !(value > 0) ? whole(value) : fixed(value, Math.max(0, Math.min(5, 1 - Math.floor(Math.log10(value)))));

/** @param {number} value @param {number} unit of pressure @returns {string} */
export const forceText = (value, unit) => `${forceNumber(value, unit)} ${FORCE_UNITS[unit]}`;

/** @param {number|string} value counts of shear @returns {string} */
export const shearText = (value) => `${value} counts`;
