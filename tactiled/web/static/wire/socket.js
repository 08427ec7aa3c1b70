/** A WebSocket to the service that connects again by itself, also where no message comes. @module */

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;
const QUIET_MS = 4000; // the service sends a status at least once a second

export class ReconnectingSocket {
  /** @param {string} url */
  constructor(url) {
    /** @type {"connecting"|"open"|"closed"} */
    this.link = "connecting";
    /** Why the link closed, as the service puts it; "" if it did not say. */
    this.reason = "";
    /** When the next attempt is due, ms on performance.now's clock. */
    this.retryAt = 0;
    /** Since a message that meant something. */
    this.attempts = 0;
    /** When the last message came, ms on performance.now's clock. */
    this.lastMessageAt = performance.now();
    this._url = url;
    this._stopped = false;
    this._timer = 0;
    this._watch = 0;
    /** @type {WebSocket|null} */
    this._socket = null;
  }

  /** A message came; RangeError where it means nothing. @param {ArrayBuffer|string} _data */
  take(_data) {}

  /** Another connection begins, whose messages have no past. */
  forget() {}

  /** The link's state changed. */
  changed() {}

  /** Connect, for the first time. */
  open() {
    this._watch = setInterval(() => this._checkQuiet(), 1000);
    this._connect();
  }

  /** @param {string} text */
  send(text) {
    this._socket?.send(text);
  }

  /** Go on with another address. @param {string} url */
  moveTo(url) {
    this._url = url;
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
    this.forget();
    const socket = new WebSocket(this._url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.link = "open";
      this.reason = "";
      this.lastMessageAt = performance.now();
      this.changed();
    };
    socket.onmessage = (event) => this._hear(event.data);
    socket.onclose = (event) => this._closed(event.reason);
    this._socket = socket;
    this.changed();
  }

  /** @param {ArrayBuffer|string} data */
  _hear(data) {
    this.lastMessageAt = performance.now();
    try {
      this.take(data);
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      this._closed(error.message);
    }
  }

  _checkQuiet() {
    if (this.link === "open" && performance.now() - this.lastMessageAt > QUIET_MS) {
      this._closed(`no message for ${QUIET_MS / 1000} s`);
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
    this.forget();
    this.retryAt = performance.now() + wait;
    this._timer = setTimeout(() => this._connect(), wait);
    this.changed();
  }
}
