/** Images over time: the highest of each cell since a moment, or the mean of the last seconds. @module */

import { measure, measures, rawMayLack } from "./measures.js";

/** @import { Frame, FrameHistory } from "../wire/frame_history.js" */
/** @import { Plane } from "./geometry.js" */

const MEAN_MS = 250; // between two means: nobody sees more, and each reads every image of its window

/** @typedef {"now"|"peak"|"1"|"5"} Held the image itself, the highest, or the mean of so many seconds */

export class HeldImage {
  constructor() {
    /** @type {Held} */
    this.kind = "now";
    /** Unix s, from which on the highest are held; NaN where no image came yet. */
    this.since = NaN;
    /** @type {Float32Array} */
    this._raw = new Float32Array(0);
    /** @type {Float32Array} */
    this._restored = new Float32Array(0);
    this._ofRaw = measures();
    this._ofRestored = measures();
    /** @type {Frame|null} */
    this._frame = null;
    this._at = -Infinity; // ms, of the last mean
    this._shown = NaN; // Unix s, of the frame that it ended with
  }

  /** Begin anew. @param {Held} [kind] */
  reset(kind = this.kind) {
    this.kind = kind;
    this.since = this._shown = NaN;
    this._frame = null;
  }

  /** Hold what a frame has more than those before it. @param {Frame} frame @param {Plane} plane */
  push(frame, plane) {
    if (this.kind !== "peak") return;
    const begins = Number.isNaN(this.since) || this._raw.length !== frame.raw.length || this._frame?.unit !== frame.unit;
    if (begins) {
      this.since = frame.timestamp;
      this._raw = frame.raw.slice();
      this._restored = frame.restored.slice();
    } else {
      raise(this._raw, frame.raw);
      raise(this._restored, frame.restored);
    }
    this._hold(frame, plane);
  }

  /**
   * @param {Frame|null} frame that is shown
   * @param {FrameHistory} history
   * @param {number} back which of its frames that is
   * @param {Plane} plane
   * @param {boolean} still the page is paused: what is shown is of this frame
   * @returns {Frame|null} what is shown in its place
   */
  of(frame, history, back, plane, still) {
    if (this.kind === "now" || !frame) return frame;
    if (this.kind === "peak") return this._frame ?? frame;
    const now = performance.now();
    const soon = !still && now - this._at < MEAN_MS;
    if (!this._frame || !(soon || this._shown === frame.timestamp)) {
      this._at = now;
      this._shown = frame.timestamp;
      const frames = kept(history, back, Number(this.kind));
      this._raw = mean(frames.map((each) => each.raw), this._raw);
      this._restored = mean(frames.map((each) => each.restored), this._restored);
      this._hold(frame, plane);
    }
    return this._frame;
  }

  /** @param {Frame} frame @param {Plane} plane */
  _hold(frame, plane) {
    const { _raw: raw, _restored: restored, _ofRaw: ofRaw, _ofRestored: ofRestored } = this;
    const noise = frame.noise || 0;
    measure(raw, plane.raw, noise, ofRaw, frame.unit, rawMayLack(plane.raw));
    measure(restored, plane.restored, noise * (frame.noiseGain || 1), ofRestored, frame.unit);
    // The highest of each cell were never pressed together: their sum is no force, and their centre none.
    if (this.kind === "peak") for (const of of [ofRaw, ofRestored]) of.force = of.x = of.y = NaN;
    this._frame = { ...frame, raw, restored, ofRaw, ofRestored, sheared: false, highest: this.kind === "peak" };
  }

  /** @returns {string} what is shown; "" for the image itself */
  get text() {
    if (this.kind === "now") return "";
    if (this.kind !== "peak") return `mean of ${this.kind} s`;
    return Number.isNaN(this.since) ? "highest" : `highest since ${new Date(1000 * this.since).toLocaleTimeString([], { hour12: false })}`;
  }
}

/** @param {Float32Array} highest @param {Float32Array} values some may be unknown */
function raise(highest, values) {
  for (let i = 0; i < highest.length; i += 1) if (!(values[i] <= highest[i]) && values[i] === values[i]) highest[i] = values[i];
}

/**
 * @param {FrameHistory} history
 * @param {number} back of the last frame
 * @param {number} seconds
 * @returns {Frame[]} those of so many seconds up to it
 */
function kept(history, back, seconds) {
  /** @type {Frame[]} */
  const frames = [];
  for (let frame = history.at(back); frame; frame = history.at(back + frames.length)) {
    const last = frames[frames.length - 1] ?? frame;
    if (frame.timestamp > last.timestamp || frame.timestamp <= frames[0]?.timestamp - seconds) break;
    frames.push(frame);
  }
  return frames;
}

/** @param {Float32Array[]} images @param {Float32Array} into if it has their size @returns {Float32Array} the mean of each cell where it is known */
export function mean(images, into) {
  const { length } = images[0];
  const means = into.length === length ? into.fill(0) : new Float32Array(length);
  const counts = new Uint16Array(length);
  for (const image of images) {
    for (let i = 0; i < length; i += 1) {
      if (image[i] !== image[i]) continue;
      means[i] += image[i];
      counts[i] += 1;
    }
  }
  for (let i = 0; i < length; i += 1) means[i] = counts[i] ? means[i] / counts[i] : NaN;
  return means;
}
