/** The last seconds of a sensor, in buffers that are allocated once. @module */

import { isImageOf } from "../maps/geometry.js";
import { measure, measures, rawMayLack, restoredMayLack } from "../maps/measures.js";
import { METHODS, RAW, RESTORED, SHEAR, TRACTION } from "./wire.js";

/** @import { Plane } from "../maps/geometry.js" */
/** @import { Measures } from "../maps/measures.js" */
/** @import { Packet } from "./wire.js" */

const MAX_FRAMES = 750; // ten seconds at 75 a second
const MAX_BYTES = 96 * 2 ** 20; // never more memory than this
const NO_FLAGS = new Uint8Array(0);
const MAX_TRACED = 45_000; // values: ten minutes at 75 a second
const GAP_S = 1; // between two frames, from which on no line joins their values

/**
 * One frame as kept.
 * @typedef {object} Frame
 * @property {number} place in the history's rings
 * @property {Float32Array} raw in `unit`
 * @property {Float32Array} restored in `unit`
 * @property {Uint8Array} flags
 * @property {number} sequence
 * @property {number} timestamp Unix s
 * @property {number} sent Unix s
 * @property {number} unit of pressures, index in UNITS; all kept frames have the same
 * @property {number} noise in `unit`
 * @property {number} noiseGain
 * @property {number} resolutionMm
 * @property {number} microseconds
 * @property {number} iterations
 * @property {string} method that was used; "" where it is unknown
 * @property {boolean} saturated any taxel is
 * @property {Float32Array} shear counts along x of all taxels, then along y; empty if the skin measures none
 * @property {Float32Array} traction kPa along x of all cells, then along y, restored; empty if it is not
 * @property {boolean} sheared both came with it
 * @property {Measures} ofRaw
 * @property {Measures} ofRestored
 * @property {boolean} [highest] it has the highest of each cell in many images, which were never there together
 */

/** The forces of frames over ten minutes, in rings. */
export class ForceTrace {
  /** @param {number} [capacity] */
  constructor(capacity = MAX_TRACED) {
    this.capacity = capacity;
    this.times = new Float64Array(capacity); // Unix s
    this.rawForces = new Float64Array(capacity);
    this.restoredForces = new Float64Array(capacity);
    this._head = 0;
    this.length = 0;
  }

  clear() {
    this._head = this.length = 0;
  }

  /** @param {number} back from the newest value @returns {number} where it is in the rings */
  place(back) {
    return (this._head - 1 - back + 2 * this.capacity) % this.capacity;
  }

  /** @param {number} time Unix s @param {number} raw force @param {number} restored */
  push(time, raw, restored) {
    if (this.length && time - this.times[this.place(0)] > GAP_S) this._add(time, NaN, NaN);
    this._add(time, raw, restored);
  }

  /** @param {number} time @param {number} raw @param {number} restored */
  _add(time, raw, restored) {
    this.times[this._head] = time;
    this.rawForces[this._head] = raw;
    this.restoredForces[this._head] = restored;
    this._head = (this._head + 1) % this.capacity;
    this.length = Math.min(this.capacity, this.length + 1);
  }
}

export class FrameHistory {
  /** @param {Plane} plane @param {number[]} kinds of image that the sensor has */
  constructor(plane, kinds) {
    this._plane = plane;
    const { raw: { count: n }, restored: { count: m } } = plane;
    const s = kinds.includes(SHEAR) ? 2 * n : 0;
    const t = kinds.includes(TRACTION) ? 2 * m : 0;
    this.capacity = Math.max(2, Math.min(MAX_FRAMES, Math.floor(MAX_BYTES / (5 * n + 4 * (m + s + t)))));
    const raw = new Float32Array(this.capacity * n);
    const restored = new Float32Array(this.capacity * m);
    const flags = new Uint8Array(this.capacity * n);
    const shear = new Float32Array(this.capacity * s);
    const traction = new Float32Array(this.capacity * t);
    /** Rings of what is drawn over time, one value a frame at its place: Unix s, and ms (NaN if never painted). */
    this.times = new Float64Array(this.capacity);
    this.latencies = new Float64Array(this.capacity);
    this.trace = new ForceTrace();
    /** @type {Frame[]} */
    this._frames = Array.from({ length: this.capacity }, (_, i) => ({
      place: i,
      raw: raw.subarray(i * n, (i + 1) * n),
      restored: restored.subarray(i * m, (i + 1) * m),
      flags: flags.subarray(i * n, (i + 1) * n),
      // NaN, not 0: the browser keeps a place for a fraction only where there was one at first.
      unit: 0, sequence: 0, timestamp: NaN, sent: NaN, noise: NaN, noiseGain: NaN, resolutionMm: NaN, microseconds: NaN,
      iterations: 0, method: "", saturated: false, ofRaw: measures(), ofRestored: measures(),
      shear: shear.subarray(i * s, (i + 1) * s), traction: traction.subarray(i * t, (i + 1) * t), sheared: false,
    }));
    this._head = 0;
    /** How many frames are kept. */
    this.length = 0;
  }

  /** Keep nothing. */
  clear() {
    this._head = this.length = 0;
    this.trace.clear();
  }

  /**
   * Does a frame fit this sensor's geometry?
   * @param {Packet[]} images by kind
   * @param {number[]} kinds that it has
   * @returns {boolean}
   */
  fits(images, kinds) {
    const { raw: taxels, restored: cells } = this._plane;
    for (let i = 0; i < kinds.length; i += 1) {
      if (!isImageOf(images[kinds[i]], kinds[i] === RAW || kinds[i] === SHEAR ? taxels : cells)) return false;
    }
    return true;
  }

  /**
   * Keep a frame, over the oldest where there is no more room.
   * @param {Packet[]} images by kind
   * @param {number[]} kinds that it has
   * @returns {Frame}
   */
  push(images, kinds) {
    const raw = images[RAW];
    const restored = images[RESTORED];
    const frame = this._frames[this._head];
    this._head = (this._head + 1) % this.capacity;
    this.length = Math.min(this.capacity, this.length + 1);
    frame.raw.set(raw.values);
    frame.restored.set(restored.values);
    frame.sheared = kinds.includes(SHEAR);
    if (frame.sheared) frame.shear.set(images[SHEAR].shear);
    if (kinds.includes(TRACTION)) frame.traction.set(images[TRACTION].shear);
    const flags = raw.flags ?? NO_FLAGS;
    frame.saturated = false;
    for (let i = 0; i < frame.flags.length; i += 1) {
      frame.flags[i] = flags[i] | 0;
      if (flags[i] & 8) frame.saturated = true;
    }
    frame.unit = restored.unit;
    frame.sequence = restored.sequence;
    frame.timestamp = restored.timestamp;
    frame.sent = restored.sent;
    frame.noise = restored.noise;
    frame.noiseGain = restored.noiseGain;
    frame.resolutionMm = restored.resolutionMm;
    frame.microseconds = restored.microseconds;
    frame.iterations = restored.iterations;
    frame.method = METHODS[restored.method] ?? "";
    const noise = Number.isFinite(frame.noise) ? frame.noise : 0;
    const gain = Number.isFinite(frame.noiseGain) ? frame.noiseGain : 1;
    measure(frame.restored, this._plane.restored, noise * gain, frame.ofRestored, frame.unit, restoredMayLack(frame.flags));
    const mayLack = frame.ofRestored.unknown ? -1 : rawMayLack(this._plane.raw); // a load may be on what did not come
    measure(frame.raw, this._plane.raw, noise, frame.ofRaw, frame.unit, mayLack);
    this.times[frame.place] = frame.timestamp;
    this.trace.push(frame.timestamp, frame.ofRaw.force, frame.ofRestored.force);
    this.latencies[frame.place] = NaN;
    return frame;
  }

  /** @param {number} back 0 for the newest, 1 for the one before it, ... @returns {Frame|null} */
  at(back) {
    return back < 0 || back >= this.length ? null : this._frames[this.place(back)];
  }

  /**
   * @param {number} back 0 for the newest frame, 1 for the one before it, ...
   * @returns {number} where it is in the rings
   */
  place(back) {
    return (this._head - 1 - back + 2 * this.capacity) % this.capacity;
  }
}
