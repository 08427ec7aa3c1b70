/** Where a recording is that plays: pure, all times are given. @module */

/** Speeds that can be chosen, of the recorded pace. */
export const SPEEDS = [0.1, 0.2, 0.5, 1, 2, 5, 10];
const MAX_NAME = 100; // characters before the ending
const SCREEN_HZ = 60; // pictures a second that are worth fetching

/** Times are ms on performance.now's clock, positions s in the recording. */
export class PlaybackClock {
  constructor() {
    this.speed = 1;
    this.playing = false;
    this._position = 0;
    this._since = 0; // when it was there
  }

  /** @param {number} now @returns {number} the position, which may be behind the recording's end */
  at(now) {
    return this.playing ? this._position + (this.speed * (now - this._since)) / 1000 : this._position;
  }

  /** Go to a position, and on from there if it plays. @param {number} position @param {number} now */
  seek(position, now) {
    this._position = position;
    this._since = now;
  }

  /** @param {boolean} to @param {number} now */
  play(to, now) {
    this.seek(this.at(now), now);
    this.playing = to;
  }

  /** @param {number} speed @param {number} now */
  setSpeed(speed, now) {
    this.seek(this.at(now), now);
    this.speed = speed;
  }
}

/**
 * @param {number} frames of a recording
 * @param {number} duration s
 * @param {number} speed
 * @returns {number} which frames are fetched to be played: each, each second, ...
 */
export function stepOf(frames, duration, speed) {
  return Math.max(1, Math.floor((frames / Math.max(duration, 1e-3)) * (speed / SCREEN_HZ)));
}

/** @param {{frames: number, duration_s: number}} recorded as far as it was read @returns {number} Hz; NaN of one frame */
export const rateOf = ({ frames, duration_s }) => (frames > 1 && duration_s > 0 ? (frames - 1) / duration_s : NaN);

/**
 * Find the messages of one frame after another.
 * @param {Uint8Array} bytes of an answer
 * @param {number} kinds messages a frame
 * @param {(message: Uint8Array) => number} sizeOf a message that these bytes begin with
 * @returns {Uint8Array[][]}
 */
export function splitFrames(bytes, kinds, sizeOf) {
  /** @type {Uint8Array[][]} */
  const frames = [];
  for (let at = 0, n = 0; at < bytes.length; n += 1) {
    const size = sizeOf(bytes.subarray(at));
    if (n % kinds === 0) frames.push([]);
    frames[frames.length - 1].push(bytes.subarray(at, at + size));
    at += size;
  }
  return frames;
}

/** @param {string} file a file's name @returns {string} the name of its recording, of characters that the service takes */
export function recordingName(file) {
  const [, stem, ending = ""] = /^(.*?)(\.(?:log|asc)\.gz|\.[^.]*)?$/i.exec(file) ?? ["", file];
  const name = stem.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^[-_]+/, "").slice(0, MAX_NAME);
  return (name || "recording") + ending.toLowerCase();
}
