/**
 * A sensor's stream: the socket, its reconnects, and one outstanding pair of images at a time.
 * @module
 */

import { packet, parse } from "./wire.js";

/** @typedef {import("./wire.js").Packet} Packet */
/** @typedef {import("./api.js").Loss} Loss */

/**
 * @typedef {object} Status
 * @property {"status"} type
 * @property {string} sensor
 * @property {import("./api.js").State} state
 * @property {number|null} age_s
 * @property {number} rate_hz
 * @property {string} detail
 * @property {Loss} loss
 * @property {string} method
 * @property {string} ran
 * @property {string} why
 * @property {number} iterations
 * @property {number} microseconds
 * @property {number} noise_kpa
 * @property {number} noise_gain
 * @property {number} resolution_mm
 * @property {string[]} warnings
 */

/**
 * @typedef {object} Listener
 * @property {(images: Packet[]) => void} onImages of one frame, each at the place of its kind; the views die with
 *   the call
 * @property {(status: Status) => void} onStatus
 * @property {() => void} onLink the link's state changed
 * @property {(found: import("./contacts.js").Found) => void} [onContacts]
 */

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;
const QUIET_MS = 4000; // the service says something at least once a second
const NEXT = JSON.stringify({ type: "next" });

export class Stream {
  /**
   * @param {string} url
   * @param {number[]} kinds of image that the address asks for
   * @param {Listener} listener
   */
  constructor(url, kinds, listener) {
    /** @type {"connecting"|"open"|"closed"} */
    this.link = "connecting";
    /** Why the link closed, in the service's words; "" where it gave none. */
    this.reason = "";
    /** When the next attempt is due, ms on performance.now's clock. */
    this.retryAt = 0;
    this.attempts = 0;
    /** When anything at all was last heard, ms on performance.now's clock. */
    this.heardAt = performance.now();
    /** When a pair was last asked for and has not come yet; 0 when none is outstanding. */
    this.askedAt = 0;
    this._url = url;
    this._listener = listener;
    this._kinds = kinds;
    this._images = [packet(), packet(), packet()];
    this._scratch = packet();
    this._stopped = false;
    this._timer = 0;
    /** @type {WebSocket|null} */
    this._socket = null;
    this._connect();
    this._watch = setInterval(() => this._checkQuiet(), 1000);
  }

  /** Ask for the next pair. */
  next() {
    if (this.link !== "open" || this.askedAt || !this._socket) return;
    this._socket.send(NEXT);
    this.askedAt = performance.now();
  }

  /**
   * Go on with another address.
   * @param {string} url
   * @param {number[]} kinds of image that it asks for
   */
  move(url, kinds) {
    this._url = url;
    this._kinds = kinds;
    if (this.link === "closed" || this._stopped) return;
    this._drop();
    this._connect();
  }

  /** Try again now instead of after the wait. */
  retry() {
    if (this.link !== "closed" || this._stopped) return;
    clearTimeout(this._timer);
    this._connect();
  }

  /** Close for good. */
  stop() {
    this._stopped = true;
    clearTimeout(this._timer);
    clearInterval(this._watch);
    this._drop();
  }

  _connect() {
    this.link = "connecting";
    this.askedAt = 0;
    this._forget();
    const socket = new WebSocket(this._url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.link = "open";
      this.reason = "";
      this.heardAt = performance.now();
      this._listener.onLink();
    };
    socket.onmessage = (event) => this._take(event.data);
    socket.onclose = (event) => this._closed(event.reason);
    this._socket = socket;
    this._listener.onLink();
  }

  /** @param {ArrayBuffer|string} data */
  _take(data) {
    this.heardAt = performance.now();
    if (typeof data === "string") {
      this._tell(JSON.parse(data));
      return;
    }
    try {
      this._keep(parse(data, this._scratch));
    } catch (error) {
      this._closed(error instanceof Error ? error.message : String(error));
    }
  }

  /** @param {Status|import("./contacts.js").Found} message */
  _tell(message) {
    if (message.type === "contacts") {
      this._listener.onContacts?.(message);
    } else if (message.type === "status") {
      this.attempts = 0;
      this._listener.onStatus(message);
    }
  }

  /** @param {Packet} one */
  _keep(one) {
    this.attempts = 0;
    if (!this._kinds.includes(one.kind)) throw new RangeError(`an image of kind ${one.kind} was not asked for`);
    this._scratch = this._images[one.kind];
    this._images[one.kind] = one;
    for (const kind of this._kinds) if (this._images[kind].sequence !== one.sequence) return;
    this.askedAt = 0;
    this._listener.onImages(this._images);
    this._forget();
  }

  /** An image seen so far is no part of a frame still to come. */
  _forget() {
    for (const image of this._images) image.sequence = -1;
  }

  _checkQuiet() {
    if (this.link === "open" && performance.now() - this.heardAt > QUIET_MS) {
      this._closed(`nothing heard for ${QUIET_MS / 1000} s`);
    }
  }

  _drop() {
    const socket = this._socket;
    this._socket = null;
    if (!socket) return;
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
  }

  /** @param {string} reason */
  _closed(reason) {
    this._drop();
    if (this._stopped) return;
    const wait = Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * 2 ** this.attempts) * (0.8 + 0.4 * Math.random());
    this.attempts += 1;
    this.link = "closed";
    this.reason = reason;
    this.askedAt = 0;
    this.retryAt = performance.now() + wait;
    this._timer = setTimeout(() => this._connect(), wait);
    this._listener.onLink();
  }
}
