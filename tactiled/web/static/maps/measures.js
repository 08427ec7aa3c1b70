/** What one image amounts to: force, peak, place of contact. @module */

import { FORCE_SCALES } from "../shell/units.js";

/** @import { Cells } from "./geometry.js" */

/**
 * @typedef {object} Measures NaN where too few cells are known
 * @property {number} force
 * @property {number} peak
 * @property {number} highest of the cells that are known
 * @property {number} peakIndex -1 where nothing is known
 * @property {number} peakX mm, of the peak of a contact; NaN without one
 * @property {number} peakY mm
 * @property {boolean} contact the peak stands clear of the noise
 * @property {number} x mm, pressure-weighted centre of contact; NaN without contact
 * @property {number} y mm
 * @property {number} unknown cells of which nothing is known
 */

const CLEAR = 5; // noise deviations from which a peak is a contact
const MAX_LOST = 0.2; // of all taxels, with more of which nothing is known: `contacts/felt.py`
const LOST = 1 | 64; // flags: missing, far below zero
const SHARE = 0.1; // of the peak from which a cell counts towards the centre

/** @returns {Measures} */
export function measures() {
  return { force: NaN, peak: NaN, highest: NaN, peakIndex: -1, peakX: NaN, peakY: NaN, contact: false, x: NaN, y: NaN, unknown: 0 };
}

/**
 * Measure an image; of a restored one nothing is known where a cell is not, as a contact may be on it.
 * @param {Float32Array} values
 * @param {Cells} cells
 * @param {number} noise standard deviation of one cell
 * @param {Measures} into
 * @param {number} [unit] of the values, which force follows
 * @param {number} [mayLack] cells that may be unknown
 */
export function measure(values, cells, noise, into, unit = 0, mayLack = 0) {
  const { count, x, y, area } = cells;
  let sum = 0;
  let peak = -Infinity;
  let peakIndex = -1;
  let unknown = 0;
  for (let i = 0; i < count; i += 1) {
    const p = values[i];
    if (p !== p) {
      if (area[i]) unknown += 1;
    } else {
      sum += p * area[i];
      if (p > peak) {
        peak = p;
        peakIndex = i;
      }
    }
  }
  into.highest = peakIndex < 0 ? NaN : peak;
  if (unknown > mayLack) {
    sum = peak = NaN;
    peakIndex = -1;
  }
  into.force = sum * FORCE_SCALES[unit];
  into.peak = peakIndex < 0 ? NaN : peak;
  into.peakIndex = peakIndex;
  into.unknown = unknown;
  into.contact = peakIndex >= 0 && peak > CLEAR * noise && peak > 0;
  into.x = into.y = into.peakX = into.peakY = NaN;
  if (!into.contact) return;
  into.peakX = x[peakIndex];
  into.peakY = y[peakIndex];
  const floor = Math.max(SHARE * peak, 3 * noise);
  let weight = 0;
  let mx = 0;
  let my = 0;
  for (let i = 0; i < count; i += 1) {
    const p = values[i];
    if (p >= floor) {
      const force = p * area[i];
      weight += force;
      mx += force * x[i];
      my += force * y[i];
    }
  }
  if (weight > 0) {
    into.x = mx / weight;
    into.y = my / weight;
  }
}

/** @param {Cells} taxels @returns {number} of a raw image, taxels that may be unknown */
export const rawMayLack = (taxels) => MAX_LOST * taxels.felt;

/** @param {Uint8Array} flags of the taxels @returns {number} of a restored image, cells that may be unknown: none, -1 where too many taxels are lost */
export function restoredMayLack(flags) {
  let lost = 0;
  for (let i = 0; i < flags.length; i += 1) if (flags[i] & LOST) lost += 1;
  return lost > MAX_LOST * flags.length ? -1 : 0;
}
