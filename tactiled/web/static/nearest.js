/**
 * What was told of some frames, found again for the frame nearest in time.
 * @module
 */

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
