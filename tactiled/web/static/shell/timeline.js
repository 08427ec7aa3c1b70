/** What came beside some of the frames, found again for the frame nearest in time. @module */

/** @template {{timestamp: number}} T */
export class Timeline {
  /**
   * @param {number} capacity
   * @param {number} within_s between the frame that an item belongs to and one that it may be shown with
   */
  constructor(capacity, within_s) {
    this._capacity = capacity;
    this._within_s = within_s;
    /** @type {T[]} the newest last */
    this._items = [];
  }

  clear() {
    this._items.length = 0;
  }

  /** @param {number} within_s as of the constructor */
  setWithin(within_s) {
    this._within_s = within_s;
  }

  /** @returns {T|undefined} */
  get newest() {
    return this._items[this._items.length - 1];
  }

  /** @param {T} item */
  push(item) {
    if (this._items.length === this._capacity) this._items.shift();
    this._items.push(item);
  }

  /** @param {number} timestamp of a frame, Unix s @returns {T|null} the item nearest to it; null where none is near */
  at(timestamp) {
    let nearest = null;
    let smallest = this._within_s;
    for (let i = this._items.length - 1; i >= 0; i -= 1) {
      const item = this._items[i];
      const distance = Math.abs(item.timestamp - timestamp);
      if (distance <= smallest) {
        smallest = distance;
        nearest = item;
      } else if (item.timestamp < timestamp) break; // the earlier ones are further away
    }
    return nearest;
  }
}

/**
 * @param {{sequence: number, timestamp: number}} item
 * @param {{sequence: number, timestamp: number}} frame that it is shown with
 * @returns {string} how far apart they are, as "38 ms later"; "" where the item belongs to the frame
 */
export function timeOffset(item, frame) {
  if (item.sequence === frame.sequence) return "";
  const ms = Math.max(1, Math.round(1000 * Math.abs(item.timestamp - frame.timestamp)));
  return `${ms} ms ${item.timestamp < frame.timestamp ? "earlier" : "later"}`;
}
