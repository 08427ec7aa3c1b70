/** Numbers as text. @module */

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
