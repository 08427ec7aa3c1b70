/**
 * Small helpers for canvases and text, shared by everything that draws.
 * @module
 */

/**
 * @template {HTMLElement} T
 * @param {string} id
 * @returns {T} the element, which the page must have
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element "${id}"`);
  return /** @type {T} */ (found);
}

/**
 * Set an element's text where it differs, so that an unchanged reading costs nothing.
 * @param {Element} element
 * @param {string} text
 */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * @param {HTMLCanvasElement} canvas
 * @returns {CanvasRenderingContext2D}
 */
export function pen(canvas) {
  const context = canvas.getContext("2d");
  if (!context) throw new Error("this browser gives no 2D canvas");
  return context;
}

/**
 * Fit a canvas's pixels to the size it is shown at.
 * @param {HTMLCanvasElement} canvas
 * @param {number} width CSS px
 * @param {number} height CSS px
 * @returns {number} device pixels per CSS px
 */
export function fit(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  const w = Math.max(1, Math.round(width * ratio));
  const h = Math.max(1, Math.round(height * ratio));
  if (canvas.width !== w) canvas.width = w;
  if (canvas.height !== h) canvas.height = h;
  return ratio;
}

/**
 * The page's colours as the theme has them now.
 * @typedef {object} Inks
 * @property {string} text
 * @property {string} muted
 * @property {string} line
 * @property {string} panel
 * @property {string} raw
 * @property {string} restored
 * @property {string} accent
 * @property {string} font
 * @property {boolean} forced the system allows few colours: they alone tell nothing apart
 */

/** @returns {Inks} */
export function inks() {
  const swatch = document.createElement("i");
  swatch.hidden = true;
  document.body.append(swatch);
  const style = getComputedStyle(swatch);
  const of = (/** @type {string} */ name) => {
    swatch.style.color = `var(--${name})`;
    return style.color;
  };
  const found = {
    text: of("text"), muted: of("muted"), line: of("line"), panel: of("panel"), raw: of("raw"),
    restored: of("restored"), accent: of("accent"), font: getComputedStyle(document.body).fontFamily,
    forced: matchMedia("(forced-colors: active)").matches,
  };
  swatch.remove();
  return found;
}

/**
 * @param {number} value
 * @param {number} digits significant ones
 * @returns {string} with a real minus sign; a dash where there is no number
 */
export function number(value, digits = 3) {
  if (!Number.isFinite(value)) return "\u2013";
  const size = Math.abs(value);
  const decimals = size === 0 ? digits - 1 : digits - 1 - Math.floor(Math.log10(size));
  return value.toFixed(Math.max(0, Math.min(digits - 1, decimals))).replace("-", "\u2212");
}

/**
 * @param {number} value
 * @param {number} decimals
 * @returns {string} with a real minus sign, never "−0.0"; a dash where there is no number
 */
export function fixed(value, decimals) {
  if (!Number.isFinite(value)) return "\u2013";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? (0).toFixed(decimals) : text.replace("-", "\u2212");
}

/**
 * @param {number} force N
 * @returns {string} with two decimals from 0.1 N on, with three significant digits below; without its unit
 */
export function newtons(force) {
  const size = Math.abs(force);
  return size < 0.09995 && size >= 1e-6 ? force.toPrecision(3).replace("-", "\u2212") : fixed(force, 2);
}
