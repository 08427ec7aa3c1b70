/** Quantities as text, each with its unit; the service's units are in `tactiled/units.py`. @module */

import { fixed, newtons, number } from "./format.js";

export const PRESSURE = "kPa";
export const N_PER_KPA_MM2 = 1e-3;

/** @param {number} value kPa @param {number} digits significant ones @returns {string} */
export const pressureText = (value, digits = 3) => `${number(value, digits)} ${PRESSURE}`;

/** @param {number} value kPa @returns {string} with one decimal */
export const readingText = (value) => `${fixed(value, 1)} ${PRESSURE}`;

/** @param {number} value mm @param {number} decimals @returns {string} */
export const lengthText = (value, decimals = 1) => `${fixed(value, decimals)} mm`;

/** @param {number} value N @returns {string} */
export const forceText = (value) => `${newtons(value)} N`;

/** @param {number|string} value counts of shear @returns {string} */
export const shearText = (value) => `${value} counts`;
