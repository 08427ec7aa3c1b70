/** What was told of some frames, found again for the frame nearest in time. @module */

/**
 * @template {{timestamp: number}} T
 * @param {number} count how many there are
 * @param {(back: number) => T} at the newest for 0, the one before it for 1, ...
 * @param {number} timestamp of a frame, Unix s
 * @param {number} within s
 * @returns {T|null} null where none is near enough
 */
export function nearest(count, at, timestamp, within) {
  let best = null;
  let least = within;
  for (let back = 0; back < count; back += 1) {
    const one = at(back);
    const away = Math.abs(one.timestamp - timestamp);
    if (away <= least) {
      least = away;
      best = one;
    } else if (one.timestamp < timestamp) break; // those before it are further away still
  }
  return best;
}

/**
 * @param {{sequence: number, timestamp: number}} told of a frame
 * @param {{sequence: number, timestamp: number}} frame
 * @returns {string} how far that frame is from this one; "" where it is the same
 */
export function timeOffset(told, frame) {
  if (told.sequence === frame.sequence) return "";
  const away = Math.max(1, Math.round(1000 * Math.abs(told.timestamp - frame.timestamp)));
  return `${away} ms ${told.timestamp < frame.timestamp ? "before" : "after"}`;
}

/**
 * What was told last, of one frame after another.
 * @template {{timestamp: number}} T
 */
export class Timeline {
  /**
   * @param {number} most that are kept
   * @param {number} within s, between the frame that something was told of and one that it may be shown with
   */
  constructor(most, within) {
    this._most = most;
    this._within = within;
    /** @type {T[]} */
    this._kept = [];
    this._newest = -1;
    /** @param {number} back */
    this._back = (back) => this._kept[(this._newest - back + this._kept.length) % this._kept.length];
  }

  /** Keep nothing. */
  clear() {
    this._kept = [];
    this._newest = -1;
  }

  /** @param {T} told */
  push(told) {
    this._newest = (this._newest + 1) % this._most;
    this._kept[this._newest] = told;
  }

  /**
   * @param {number} timestamp of a frame
   * @returns {T|null} what was told of it, or of the one nearest in time; null where none is near
   */
  at(timestamp) {
    return nearest(this._kept.length, this._back, timestamp, this._within);
  }
}
