/** The colours of pressure maps, as the service gives them, and two more for what lies beyond their range. @module */

/** @typedef {[number, number, number]} Color red, green and blue, 0 to 255 */

export const BELOW = 256; // index of what is clearly below zero,
export const ABOVE = 257; // and of what is above the range
/** @type {Color[]} that no colour map of pressures has at that end, */
const BEYOND = [[122, 140, 255], [0, 229, 255]];
/** @type {Color[]} and that of differences has not */
const BEYOND_SIGNED = [[0, 229, 255], [255, 196, 0]];

/** The 256 colours and those of BEYOND, as pixels and as CSS. */
export class Colormap {
  /** @param {Color[]} colors @param {boolean} [signed] it is of differences: below is what is below its range */
  constructor(colors, signed = false) {
    const all = [...colors, ...(signed ? BEYOND_SIGNED : BEYOND)];
    /** One little-endian RGBA word a colour. */
    this.rgba = Uint32Array.from(all, ([r, g, b]) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0);
    this.css = all.map(([r, g, b]) => `rgb(${r} ${g} ${b})`);
    this.signed = signed;
  }

  /**
   * @param {number} value
   * @param {import("./display_range.js").DisplayRange} range
   * @returns {number} index of its colour
   */
  index(value, range) {
    if (value > range.high) return ABOVE;
    if (value < (this.signed ? range.low : range.floor)) return BELOW;
    const level = ((value - range.low) * 256) / (range.high - range.low);
    return level <= 0 ? 0 : level >= 255 ? 255 : level | 0;
  }
}
