/** Numbers as text. @module */

const BYTE_UNITS = ["B", "kB", "MB", "GB"];

/**
 * @param {number} value
 * @param {number} digits significant ones
 * @returns {string} with a real minus sign; a dash where there is no number
 */
export function number(value, digits = 3) {
  if (!Number.isFinite(value)) return "\u2013";
  const size = Math.abs(value) / (1 - 0.5 * 10 ** -digits); // rounded up, 99.96 has three digits before the point
  const decimals = size === 0 ? digits - 1 : digits - 1 - Math.floor(Math.log10(size));
  return fixed(value, decimals > digits + 2 ? digits : Math.max(0, decimals)); // of what is smaller only that it is small
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

/** @param {number} force N @returns {string} with three significant digits, five decimals at most; without its unit */
export function newtons(force) {
  const size = Math.abs(force);
  if (size < 1e-3 && size >= 5e-6) return fixed(force, 5);
  return size < 1 && size >= 1e-3 ? force.toPrecision(3).replace("-", "\u2212") : number(force);
}

/** @param {number} value @returns {string} without decimals; from a million on with a power of ten, as 1.08e6 */
export function whole(value) {
  const isLarge = Number.isFinite(value) && Math.abs(value) >= 999_999.5;
  return isLarge ? value.toExponential(2).replace("e+", "e").replace("-", "\u2212") : fixed(value, 0);
}

/** @param {number} seconds @returns {string} */
export function duration(seconds) {
  if (seconds < 100) return `${fixed(seconds, 1)} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  return `${Math.floor(seconds / 3600)} h`;
}

/** @param {number} time s, Unix @param {"short"|"medium"} precision of the time of day @returns {string} date and time */
export const dateText = (time, precision) =>
  new Date(1000 * time).toLocaleString([], { dateStyle: "medium", timeStyle: precision, hour12: false });

/** @param {number} seconds in a recording @returns {string} minutes and seconds, with hours where there are any */
export function positionText(seconds) {
  if (!Number.isFinite(seconds)) return "\u2013";
  const tenths = Math.max(0, Math.round(10 * seconds)); // first, or 59.97 s would be 60.0
  const [hours, minutes, rest] = [Math.floor(tenths / 36000), Math.floor(tenths / 600) % 60, tenths % 600];
  const tail = `${(rest / 10).toFixed(1).padStart(4, "0")}`;
  return hours ? `${hours}:${String(minutes).padStart(2, "0")}:${tail}` : `${minutes}:${tail}`;
}

/** @param {number} bytes @returns {string} */
export function byteText(bytes) {
  if (bytes < 1000) return `${bytes} B`;
  const power = Math.min(BYTE_UNITS.length - 1, Math.floor(Math.log10(bytes) / 3));
  return `${number(bytes / 1000 ** power)} ${BYTE_UNITS[power]}`;
}
