/**
 * The service's JSON interface.
 * @module
 */

const ROOT = "/api/v1";
const TIMEOUT_MS = 8000;

/** @typedef {"live"|"stale"|"silent"|"down"} State */

/** @typedef {Record<"lost"|"repeated"|"late"|"foreign"|"malformed"|"incomplete"|"skipped", number>} Loss */

/**
 * @typedef {object} Sensor
 * @property {string} name
 * @property {string} bus
 * @property {string} codec
 * @property {number|null} rows
 * @property {number|null} columns
 * @property {number} taxels
 * @property {number} pitch_mm
 * @property {string} method
 * @property {string[]} methods
 * @property {State} state
 * @property {number|null} age_s
 * @property {number} rate_hz
 * @property {string} detail
 * @property {Loss} loss
 * @property {number|null} sequence
 */

/**
 * @typedef {object} Geometry
 * @property {[number, number]|null} shape
 * @property {[number, number][]} positions_mm
 * @property {number} pitch_mm
 * @property {"square"|"round"} aperture
 * @property {number} aperture_mm
 * @property {{rows: number, columns: number}} raw
 * @property {{rows: number, columns: number, cell_mm: number}} restored
 * @property {number[]|null} areas_mm2 where the layout is no grid
 */

/**
 * @typedef {object} Kernel
 * @property {number[]} r_mm
 * @property {number[]} g_per_mm2
 * @property {number[]} q_per_mm
 * @property {number[]} gain
 * @property {number} nyquist_per_mm
 * @property {number} nyquist_gain
 * @property {number|null} smallest_gap_mm
 * @property {string} model
 * @property {number} error_estimate
 */

/** @typedef {{name: string, colors: [number, number, number][]}} Colormap */

/** An answer that is not a success, with the service's own words where it gave any. */
export class ApiError extends Error {
  /**
   * @param {number} status HTTP status; 0 where no answer came
   * @param {string} message
   */
  constructor(status, message) {
    super(message);
    this.name = "ApiError";
    this.status = status;
  }
}

/**
 * @param {string} path below the API's root
 * @param {RequestInit} [options]
 * @returns {Promise<any>} the body, or null where there is none
 */
async function request(path, options = {}) {
  let response;
  try {
    response = await fetch(ROOT + path, { ...options, signal: AbortSignal.timeout(TIMEOUT_MS) });
  } catch (error) {
    throw new ApiError(0, error instanceof DOMException && error.name === "TimeoutError"
      ? `no answer within ${TIMEOUT_MS / 1000} s` : "the service cannot be reached");
  }
  const text = await response.text();
  let body = null;
  try {
    body = text ? JSON.parse(text) : null;
  } catch {
    body = null;
  }
  if (!response.ok) throw new ApiError(response.status, body?.detail || body?.title || `HTTP ${response.status}`);
  return body;
}

/**
 * @param {string} name
 * @returns {string} a sensor's path
 */
const at = (name) => `/sensors/${encodeURIComponent(name)}`;

/** @returns {Promise<Sensor[]>} */
export const sensors = async () => (await request("/sensors")).sensors;

/**
 * @param {string} name
 * @returns {Promise<Geometry>}
 */
export const geometry = (name) => request(`${at(name)}/geometry`);

/**
 * @param {string} name
 * @returns {Promise<Kernel>}
 */
export const kernel = (name) => request(`${at(name)}/kernel`);

/** @returns {Promise<Colormap>} */
export const colormap = () => request("/colormap");

/**
 * @param {string} name
 * @param {string} method
 * @returns {Promise<{method: string}>}
 */
export const setMethod = (name, method) =>
  request(`${at(name)}/method`, {
    method: "PUT", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ method }),
  });

/**
 * @param {string} name
 * @returns {Promise<unknown>}
 */
export const tare = (name) => request(`${at(name)}/tare`, { method: "POST" });

/**
 * @param {string} name
 * @returns {string} the WebSocket address of a sensor's stream
 */
export function streamUrl(name) {
  const url = new URL(`${ROOT}${at(name)}/stream`, location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  // A little above the screen: the credits keep the pace, and a limit at the screen's own rate would miss turns.
  url.search = "?kinds=raw,restored&rate_hz=75&flow=credit";
  return url.href;
}
