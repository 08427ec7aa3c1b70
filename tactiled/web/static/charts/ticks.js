/** The ticks of axes and of the legend, with their texts. @module */

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** @param {number} power @returns {string} ten to that power */
function decade(power) {
  if (power === 0) return "1";
  if (power === -1) return "0.1";
  return `10${power < 0 ? "⁻" : ""}${SUPERSCRIPTS[Math.abs(power)]}`;
}

/** @typedef {{value: number, text: string}} Tick */

/** @param {number} low @param {number} high @param {number} max how many at most, about @returns {Tick[]} */
export const labelledTicks = (low, high, max) =>
  ticks(low, high, max).map((value) => ({ value, text: tickText(value, high - low) }));

/** @param {number} low power of ten @param {number} high @returns {Tick[]} */
export const decadeTicks = (low, high) =>
  Array.from({ length: high - low + 1 }, (_, i) => ({ value: low + i, text: decade(low + i) }));

/**
 * @param {number} low
 * @param {number} high
 * @param {number} max how many at most, about
 * @returns {number[]} round numbers in the range, evenly spaced
 */
export function ticks(low, high, max) {
  const parts = Math.max(1, max);
  const rough = (high - low) / parts;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((each) => each * power).find((each) => each >= rough * (1 - 1e-9)) ?? 10 * power;
  const first = Math.ceil(low / step - 1e-9);
  const count = Math.min(parts + 1, Math.floor(high / step + 1e-9) - first + 1);
  const out = [];
  for (let i = 0; i < count; i += 1) out.push((first + i) * step || 0); // never -0
  return out;
}

/**
 * @param {number} low
 * @param {number} high
 * @param {number} max how many at most, about
 * @returns {number[]} both ends of the range, and between them its ticks, but for those too near to an end
 */
export function endsAndTicks(low, high, max) {
  const near = (0.6 * (high - low)) / Math.max(1, max);
  return [low, ...ticks(low, high, max).filter((each) => each - low > near && high - each > near), high];
}

/** @param {number} value other than 0 @param {number} span @returns {string} with a power of ten, as 1.5e6 */
function powered(value, span) {
  const digits = Math.max(2, Math.min(8, 2 + Math.ceil(Math.log10(Math.abs(value) / span))));
  return value.toExponential(digits).replace(/\.?0*e\+?/, "e").replaceAll("-", "\u2212");
}

/**
 * @param {number} value
 * @param {number} span of the range it stands in, which sets its decimals
 * @returns {string}
 */
export function tickText(value, span) {
  if (value && (span < 1e-3 || Math.abs(value) >= 1e5)) return powered(value, span);
  const decimals = Math.max(0, Math.min(4, 2 - Math.floor(Math.log10(span))));
  return String(Number(value.toFixed(decimals))).replace("-", "\u2212");
}
