/** The colour map of all pressure maps, as the service gives it. @module */

/** The 256 colours, as pixels and as CSS. */
export class Colormap {
  /** @param {[number, number, number][]} colors */
  constructor(colors) {
    /** One little-endian RGBA word a colour. */
    this.rgba = Uint32Array.from(colors, ([r, g, b]) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0);
    this.css = colors.map(([r, g, b]) => `rgb(${r} ${g} ${b})`);
  }
}
