/**
 * Restored images of several sensors, and the shear of some, restored or not, on one socket: one outstanding of each at a time.
 * @module
 */

import { ReconnectingSocket } from "./socket.js";
import { RESTORED, isOf, packet, parse } from "./wire.js";

/** @import { Status } from "./sensor_stream.js" */
/** @import { Packet } from "./wire.js" */

/**
 * @typedef {object} Listener
 * @property {(image: Packet) => void} onImage its views die with the call; shear comes behind its frame's pressures
 * @property {(status: Status) => void} onStatus
 * @property {() => void} onLink the link's state changed
 */

/** One sensor's part of the socket: a way of its own as far as anyone can tell. */
export class TileStream {
  /** @param {WallStream} all @param {string} name of the sensor @param {Listener} listener */
  constructor(all, name, listener) {
    this.name = name;
    this.bytes = new TextEncoder().encode(name);
    this.listener = listener;
    /** When the last message of this sensor came, ms on performance.now's clock. */
    this.lastMessageAt = performance.now();
    /** When an image was last requested and has not come yet; 0 when none is outstanding. */
    this.requestedAt = 0;
    this.socket = all;
    this._next = JSON.stringify({ type: "next", sensor: name });
  }

  /** Ask for the next image. */
  next() {
    if (this.socket.link !== "open" || this.requestedAt) return;
    this.socket.send(this._next);
    this.requestedAt = performance.now();
  }
}

export class WallStream extends ReconnectingSocket {
  /** @param {string} url whose sensors become parts before it is opened */
  constructor(url) {
    super(url);
    /** @type {TileStream[]} */
    this._parts = [];
    this._image = packet();
  }

  /** @param {string} name of the sensor @param {Listener} listener @returns {TileStream} */
  part(name, listener) {
    const part = new TileStream(this, name, listener);
    this._parts.push(part);
    return part;
  }

  /** @override @param {ArrayBuffer|string} data */
  take(data) {
    if (typeof data === "string") this._takeStatus(JSON.parse(data));
    else this._takeImage(parse(new Uint8Array(data), this._image));
  }

  /** @override */
  forget() {
    for (const part of this._parts) part.requestedAt = 0;
  }

  /** @override */
  changed() {
    for (const part of this._parts) {
      if (this.link === "open") part.lastMessageAt = this.lastMessageAt;
      part.listener.onLink();
    }
  }

  /** @param {Status} status */
  _takeStatus(status) {
    const part = this._parts.find((each) => each.name === status.sensor);
    if (status.type !== "status" || !part) return;
    this.attempts = 0;
    part.lastMessageAt = this.lastMessageAt;
    part.listener.onStatus(status);
  }

  /** @param {Packet} image */
  _takeImage(image) {
    for (let i = 0; i < this._parts.length; i += 1) {
      const part = this._parts[i];
      if (!isOf(image, part.bytes)) continue;
      this.attempts = 0;
      part.lastMessageAt = this.lastMessageAt;
      if (image.kind === RESTORED) part.requestedAt = 0;
      part.listener.onImage(image);
      return;
    }
    throw new RangeError("an image of a sensor that was not requested");
  }
}
