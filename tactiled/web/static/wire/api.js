/** The service's JSON interface. @module */

import { npy } from "../export/npy.js";
import { KIND_NAMES } from "./wire.js";

const ROOT = "/api/v1";
const TIMEOUT_MS = 8000;
const UPLOAD_TIMEOUT_MS = 600_000; // as the service's
const APPLY_TIMEOUT_MS = 60_000; // a cover is solved

/** @typedef {"live"|"stale"|"silent"|"down"|"ended"} State */
/** @typedef {{code: string, taxels: number|null, text: string}} Warning */

/**
 * What went wrong on the way in, counted since the service started.
 * @typedef {Record<"lost"|"repeated"|"late"|"foreign"|"malformed"|"dropped"|"incomplete"|"skipped"|"errors"|"bus_off"
 *   |"unsent"|"unreadable"|"undelivered", number>} Loss
 */

/**
 * @typedef {{
 *   name: string, bus: string, codec: string, rows: number|null, columns: number|null, taxels: number,
 *   pitch_mm: number, shear: boolean, traction: boolean, unit: string, method: string, methods: string[], state: State, age_s: number|null,
 *   rate_hz: number, jitter_s: number|null, skew_s: number|null, position_s: number|null, clock: string|null,
 *   detail: string, loss: Loss,
 *   error_kinds: Record<string, number>, sequence: number|null
 * }} Sensor
 */

/**
 * Where the taxels are; `shape` is null and `areas_mm2` given where the layout is no grid.
 * @typedef {{
 *   shape: [number, number]|null, positions_mm: [number, number][], pitch_mm: number, aperture: "square"|"round",
 *   aperture_mm: number, raw: {rows: number, columns: number},
 *   restored: {rows: number, columns: number, cell_mm: number, origin_mm: [number, number], mask: boolean[][]|null},
 *   areas_mm2: number[]|null
 * }} Geometry
 */

/**
 * @typedef {{
 *   r_mm: number[], g_per_mm2: number[], q_per_mm: number[], gain: number[], nyquist_per_mm: number,
 *   nyquist_gain: number, smallest_gap_mm: number|null, model: string, error_estimate: number
 * }} Kernel
 */

/**
 * `bytes` is null where the file was moved or removed, `messages` where this service did not start the recording;
 * `error` says why it ended early.
 * @typedef {{
 *   name: string, bytes: number|null, modified: number|null, duration_s: number|null, running: boolean,
 *   bus: string|null, messages: number|null, error: string|null
 * }} Recording
 */

/**
 * A sensor's part of a recording; more comes while `reading`. `force` is of the raw images at `positions_s`.
 * @typedef {{
 *   name: string, sensor: string, frames: number, reading: boolean, error: string|null, duration_s: number,
 *   timestamp: number|null, unit: string, tared_at: number|null, calibration: string, positions_s: number[],
 *   force: number[], caveats: string[]
 * }} Played
 */

/**
 * @typedef {{
 *   number: number, position_s: number, sequence: number, timestamp: number, skew_s: number, method: string,
 *   why: string, iterations: number, microseconds: number, unit: string, noise: number, noise_gain: number,
 *   resolution_mm: number, loss: Loss, warnings: Warning[], contacts: import("./sensor_stream.js").Contact[]
 * }} PlayedFrame
 */

/** @typedef {{value: number|null, number: number, position_s: number}} Highest `number` is that of the frame */

/**
 * Of the array or a region; of each piece of the recording the highest values.
 * @typedef {{name: string, highest: Record<Measure, Highest>} & Record<Measure, (number|null)[]>} AreaSeries
 */

/**
 * Restored images of a whole recording; `total` is null until the end of measuring.
 * @typedef {{
 *   method: string, frames: number, measured: number, running: boolean, error: string|null, unit: string,
 *   position_s: number[], total: AreaSeries|null, regions: AreaSeries[]
 * }} RecordedSeries
 */

/**
 * @typedef {{
 *   id: number, time: number, kind: string, sensor: string|null, bus: string|null, text: string, warning: Warning|null
 * }} Event
 */

/**
 * `load` is what of a load the newest frames show, "" for none; `session` the guided calibration that is open.
 * @typedef {{
 *   calibrated: boolean, kpa_per_count: number|null, dead: number[], load: string, tared_at?: number|null,
 *   can_undo?: boolean, session: Way|null, id?: string
 * }} Calibration
 */

/** @typedef {{taxel: number, fault: string, reason: string, since: number}} TaxelFault */

/** @typedef {"uniform"|"weight"|"tip"|"edge"|"blind"} Way */

/**
 * What the frames so far are good for; `last_unused` says why the last press is not used; `zones` has the presses in 3 x 3 zones, or is empty where places do not matter.
 * @typedef {{
 *   advice: string, enough: boolean, presses: number, presses_needed: number, presses_saturated: number,
 *   last_unused: string, zones: number[][], zone_presses_needed: number
 * }} Quality
 */

/**
 * @typedef {{
 *   form: string, kpa_per_count: number, interval_kpa_per_count: [number, number]|null,
 *   before_kpa_per_count: number|null, spread_percent: number|null, hysteresis_percent: number|null, notes: string[],
 *   line: {counts: (number|null)[], measured_kpa: (number|null)[], fitted_kpa: (number|null)[]}
 * }} GainResult
 */

/**
 * `reason` says why the presses cannot tell the thickness; "" where they can.
 * @typedef {{
 *   thickness_mm: number, interval_mm: [number, number], before_mm: number, presses: number, residual: number|null,
 *   reason: string, notes: string[],
 *   line: {x_mm: (number|null)[], measured: (number|null)[], fitted: (number|null)[]}|null
 * }} CoverResult
 */

/**
 * @typedef {{
 *   sensor: string, way: Way, size_mm: number|null, state: "collecting"|"fitting"|"fitted"|"ended", frames: number,
 *   seconds: number, seconds_limit: number, full: boolean, load: string, quality: Quality,
 *   error: string, gain: GainResult|null, cover: CoverResult|null
 * }} CalibrationSession
 */

/** An answer that is not a success, with the service's own text if it gave one. */
export class ApiError extends Error {
  /**
   * @param {number} status HTTP status; 0 where no answer came
   * @param {string} message
   * @param {{code?: string, seen?: string}} [problem] what a program may act on
   */
  constructor(status, message, { code = "", seen = "" } = {}) {
    super(message);
    this.name = "ApiError";
    this.status = status;
    this.code = code;
    this.seen = seen;
  }
}

/** @typedef {RequestInit & {timeout_ms?: number}} Options until when an answer must come */

/**
 * @param {string} path below the service's root
 * @param {Options} options
 * @returns {Promise<Response>} whatever its status; ApiError where none came
 */
async function answer(path, { timeout_ms = TIMEOUT_MS, ...options }) {
  try {
    return await fetch(path, { signal: AbortSignal.timeout(timeout_ms), ...options });
  } catch (error) {
    throw new ApiError(0, error instanceof DOMException && error.name === "TimeoutError"
      ? `no answer within ${timeout_ms / 1000} s` : "the service cannot be reached");
  }
}

/** @param {Response} response @returns {Promise<any>} the JSON in it, or null where there is none */
async function json(response) {
  const text = await response.text();
  try {
    return text ? JSON.parse(text) : null;
  } catch {
    return null;
  }
}

/**
 * @param {string} path below the API's root
 * @param {Options} [options]
 * @returns {Promise<Response>} a success; else ApiError
 */
async function succeed(path, options = {}) {
  const response = await answer(ROOT + path, options);
  if (response.ok) return response;
  const body = await json(response);
  throw new ApiError(response.status, body?.detail || body?.title || `HTTP ${response.status}`, body ?? {});
}

/**
 * @param {string} path below the API's root
 * @param {Options} [options]
 * @returns {Promise<any>} the body, or null where there is none
 */
const request = async (path, options) => json(await succeed(path, options));

/** @param {"POST"|"PUT"} method @param {unknown} body @returns {RequestInit} */
const sending = (method, body) =>
  ({ method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });

/** @param {string} name @returns {string} a sensor's path */
const at = (name) => `/sensors/${encodeURIComponent(name)}`;

/** @returns {Promise<Sensor[]>} */
export const sensors = async () => (await request("/sensors")).sensors;

/** @param {string} name @returns {Promise<Sensor>} */
export const sensor = (name) => request(at(name));

/** @param {string} name @returns {Promise<Geometry>} */
export const geometry = (name) => request(`${at(name)}/geometry`);

/** @param {string} name @returns {Promise<Kernel>} */
export const kernel = (name) => request(`${at(name)}/kernel`);

/** @param {string} name @returns {Promise<{name: string, colors: [number, number, number][]}>} */
export const colormap = (name) => request(`/colormap?name=${name}`);

/** @param {string} name @param {string} method @returns {Promise<{method: string}>} */
export const setMethod = (name, method) =>
  request(`${at(name)}/method`, sending("PUT", { method }));

/** @param {string} name @param {boolean} force even where a load is seen @returns {Promise<unknown>} */
export const tare = (name, force) => request(`${at(name)}/tare${force ? "?force=true" : ""}`, { method: "POST" });

/** @param {string} name @returns {Promise<unknown>} */
export const undoTare = (name) => request(`${at(name)}/tare`, { method: "DELETE" });

/** @typedef {"rectangle"|"ellipse"|"polygon"} Shape */

/** @typedef {{force: number|null, mean: number|null, peak: number|null, area: number|null}} RegionMeasures */

/**
 * @typedef {{
 *   name: string, shape: Shape, points_mm: [number, number][],
 *   threshold: {quantity: Measure, above: number, below: number}|null, unit: string, now: RegionMeasures|null,
 *   highest: RegionMeasures|null, impulse: number, pressure_time: number, since: number|null, exceeded: boolean
 * }} Region
 */

/** @typedef {"force"|"mean"|"peak"|"area"} Measure of a region */

/** @typedef {Measure|"x"|"y"} Quantity x and y are a contact's centre of pressure */

/** @typedef {{unit: string, time: number[]} & Partial<Record<Quantity, (number|null)[]>>} Series values over time (Unix s); null: not known */

/** @param {string} name @returns {Promise<Region[]>} */
export const regions = async (name) => (await request(`${at(name)}/regions`)).regions;

/** @param {string} name @param {string} region @returns {string} */
const atRegion = (name, region) => `${at(name)}/regions/${encodeURIComponent(region)}`;

/** @param {string} name @param {string} region @param {Pick<Region, "shape"|"points_mm"> & {threshold: {quantity: Measure, above: number, below?: number}|null}} body @returns {Promise<Region>} */
export const putRegion = (name, region, body) => request(atRegion(name, region), sending("PUT", body));

/** @param {string} name @param {string} region @returns {Promise<null>} */
export const removeRegion = (name, region) => request(atRegion(name, region), { method: "DELETE" });

/** @param {string} name @param {string} region @returns {Promise<null>} */
export const resetRegion = (name, region) => request(`${atRegion(name, region)}/reset`, { method: "POST" });

/**
 * @param {string} name
 * @param {string} region
 * @param {number} seconds
 * @param {number|null} until Unix s, where they end; null: at the newest image
 * @param {number} points at most
 * @returns {Promise<Series>}
 */
export const regionSeries = (name, region, seconds, until, points) =>
  request(`${atRegionSeries(name, region, seconds, until)}&points=${points}`);

/** @param {string} name @param {string} region @param {number} seconds @param {number|null} until as of regionSeries @returns {string} where the series is to be had */
export const regionCsv = (name, region, seconds, until) => `${ROOT}${atRegionSeries(name, region, seconds, until)}&format=csv`;

/** @param {string} name @param {string} region @param {number} seconds @param {number|null} until @returns {string} */
const atRegionSeries = (name, region, seconds, until) =>
  `${atRegion(name, region)}/series?seconds=${seconds}${until === null ? "" : `&until=${until}`}`;

/** @param {string} name @returns {Promise<Calibration>} */
export const calibration = (name) => request(`${at(name)}/calibration`);

/** @param {string} name @returns {Promise<{faults: TaxelFault[], map: string|null}>} */
export const taxelHealth = (name) => request(`${at(name)}/health`);

/** @param {string} name @returns {string} the path of a sensor's guided calibration */
const atSession = (name) => `${at(name)}/calibration/session`;

/** @param {string} name @returns {Promise<CalibrationSession|null>} the one that is open; null for none */
export async function calibrationSession(name) {
  try {
    return await request(atSession(name));
  } catch (error) {
    if (error instanceof ApiError && error.status === 404) return null;
    throw error;
  }
}

/** @param {string} name @param {{way: Way, tip_mm?: number, edge_mm?: number}} how @returns {Promise<CalibrationSession>} */
export const startCalibration = (name, how) => request(atSession(name), sending("POST", how));

/** @param {string} name @param {{pressure_kpa?: number, weight_n?: number}} load @returns {Promise<CalibrationSession>} */
export const markLoad = (name, load) => request(`${atSession(name)}/mark`, sending("POST", load));

/** @param {string} name @param {"fit"|"cancel"|"apply"} action @returns {Promise<CalibrationSession|null>} */
export const calibrationAction = (name, action) =>
  request(`${atSession(name)}/${action}`, { method: "POST", timeout_ms: APPLY_TIMEOUT_MS });

/** @param {string} name @returns {Promise<{files: {number: number, id: string|null}[]}>} what was in force before, the newest first */
export const formerCalibrations = (name) => request(`${at(name)}/calibration/history`);

/** @param {string} name @param {number} number of the history @returns {Promise<Calibration>} */
export const applyFormer = (name, number) =>
  request(`${at(name)}/calibration/history/${number}`, { method: "POST", timeout_ms: APPLY_TIMEOUT_MS });

/** @param {string} name @returns {Promise<null>} */
export const discardCalibration = (name) => request(atSession(name), { method: "DELETE" });

/**
 * @param {string} name
 * @returns {Promise<{timestamp: number, unit: string, values: Float32Array}>} the newest image's standard deviation, a cell
 */
export async function deviation(name) {
  const response = await succeed(`${at(name)}/frames/deviation?format=npy`);
  const { headers } = response;
  const unit = headers.get("X-Tactiled-Unit") ?? "";
  return { timestamp: Number(headers.get("X-Tactiled-Timestamp")), unit, values: npy(await response.arrayBuffer()) };
}

/** @returns {Promise<Set<string>>} the paths that this service has, below the API's root */
export async function offered() {
  const paths = Object.keys((await request("/openapi.json")).paths);
  return new Set(paths.map((each) => each.slice(ROOT.length)));
}

/** @returns {Promise<boolean>} the service is that of `tactiled demo` */
export const isDemo = async () => Object.values((await request("/config")).bus).some(
  (/** @type {{interface: string, channel: string}} */ each) => each.interface === "virtual" && each.channel === "demo");

/**
 * @param {number} after id of the newest event that is known
 * @returns {Promise<{events: Event[], newest: number}>} all that the service still has
 */
export const events = (after) => request(`/events?after=${after}&limit=1000`);

/** @returns {Promise<Recording[]>} all of them, page by page */
export async function recordings() {
  const all = [];
  for (let after = ""; after !== null;) {
    const page = await request(`/recordings?limit=1000&after=${encodeURIComponent(after)}`);
    all.push(...page.recordings);
    after = page.after;
  }
  return all;
}

/** @param {string} name @returns {string} a recording's path */
const atRecording = (name) => `/recordings/${encodeURIComponent(name)}`;

/** @param {string} bus @returns {Promise<Recording>} */
export const startRecording = (bus) => request("/recordings", sending("POST", { bus }));

/** @param {string} name @returns {Promise<Recording>} */
export const stopRecording = (name) => request(`${atRecording(name)}/stop`, { method: "POST" });

/** @param {string} name @returns {Promise<unknown>} */
export const deleteRecording = (name) => request(atRecording(name), { method: "DELETE" });

/** @param {string} name @returns {string} where the file is to be had */
export const recordingUrl = (name) => ROOT + atRecording(name);

/** @param {Record<string, string|number|boolean>} values @returns {string} */
const asQuery = (values) => `?${new URLSearchParams(Object.entries(values).map(([key, value]) => [key, String(value)]))}`;

/** @param {string} name @param {string} sensor @returns {Promise<Played>} */
export const played = (name, sensor) => request(`${atRecording(name)}/playback${asQuery({ sensor })}`);

/**
 * @param {string} name
 * @param {Record<string, string|number|boolean>} query
 * @returns {Promise<{first: number, positions: number[], bytes: Uint8Array}>} frames and where they are
 */
export async function recordedFrames(name, query) {
  const response = await succeed(`${atRecording(name)}/frames${asQuery(query)}`);
  const first = Number(response.headers.get("X-Tactiled-Frame"));
  const positions = (response.headers.get("X-Tactiled-Positions") ?? "").split(",").map(Number);
  return { first, positions, bytes: new Uint8Array(await response.arrayBuffer()) };
}

/**
 * @param {string} name
 * @param {Record<string, string|number|boolean>} query
 * @returns {Promise<{frames: {number: number, sequence: number, timestamp: number, contacts: import("./sensor_stream.js").Contact[]}[]}>}
 */
export const recordedContacts = (name, query) => request(`${atRecording(name)}/contacts${asQuery(query)}`);

/** @param {string} name @param {string} sensor @param {number} number @param {string} method "" for the live one @returns {Promise<PlayedFrame>} */
export const recordedFrame = (name, sensor, number, method) =>
  request(`${atRecording(name)}/frames/${number}${asQuery(method ? { sensor, method } : { sensor })}`);

/** @param {string} name @param {string} sensor @param {string} method "" for the live one @returns {string} */
const atSeries = (name, sensor, method) => `${atRecording(name)}/series${asQuery(method ? { sensor, method } : { sensor })}`;

/** @param {string} name @param {string} sensor @param {string} method "" for the live one @returns {Promise<RecordedSeries>} */
export const recordedSeries = (name, sensor, method) => request(atSeries(name, sensor, method));

/** @param {string} name @param {string} sensor @param {string} method @returns {string} where it is to be had */
export const recordedSeriesCsv = (name, sensor, method) => `${ROOT}${atSeries(name, sensor, method)}&format=csv`;

/** @param {string} name @param {Blob} file @returns {Promise<Recording>} */
export const uploadRecording = (name, file) =>
  request(atRecording(name), { method: "PUT", body: file, timeout_ms: UPLOAD_TIMEOUT_MS });

/** Show a token; the service keeps it in a cookie that no script reads. @param {string} token */
export async function showToken(token) {
  const response = await answer(`/?token=${encodeURIComponent(token)}`, { cache: "no-store" });
  if (!response.ok) throw new ApiError(response.status, "the service does not know this token");
}

/** @param {string} path below the API's root @returns {string} the WebSocket address */
function socket(path) {
  const url = new URL(ROOT + path, location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url.href;
}

/**
 * @param {string} name
 * @param {boolean} contacts whether they are to come, too
 * @param {number[]} kinds of image
 * @returns {string} the address of a frame's images, those of one at a time
 */
export const streamUrl = (name, contacts, kinds) =>
  // A little above the screen: the credits keep the pace, and a limit at the screen's own rate would miss turns.
  socket(`${at(name)}/stream?kinds=${kinds.map((each) => KIND_NAMES[each]).join()}&rate_hz=75&flow=credit${contacts ? "&contacts=1" : ""}`);

/**
 * @param {string[]} names
 * @param {string[]} sheared those of them whose shear is to come, too
 * @param {string[]} dragged those whose restored shear is
 * @param {number} rate_hz at most, of each
 * @returns {string} the address of several sensors' restored images, one of each at a time
 */
export const wallUrl = (names, sheared, dragged, rate_hz) =>
  socket(`/stream?sensors=${names.join(",")}&kinds=restored${among("shear", sheared)}${among("traction", dragged)}&rate_hz=${rate_hz}&flow=credit`);

/** @param {string} key @param {string[]} names @returns {string} a part of a query */
const among = (key, names) => (names.length ? `&${key}=${names.join(",")}` : "");
