/** A sensor's stream: never more frames under way than were requested. @module */

import { ReconnectingSocket } from "./socket.js";
import { KIND_NAMES, kindOf, packet, parse } from "./wire.js";

/** @import { Loss, State, Warning } from "./api.js" */
/** @import { Packet } from "./wire.js" */

/**
 * The stream's JSON message on the sensor and its newest image.
 * @typedef {{
 *   type: "status", sensor: string, state: State, age_s: number|null, rate_hz: number, jitter_s: number|null,
 *   skew_s: number|null, position_s: number|null, detail: string, loss: Loss, method: string, sequence: number, timestamp: number, ran: string,
 *   why: string, iterations: number, microseconds: number, unit: string, noise: number, noise_gain: number,
 *   resolution_mm: number, calibration: string, warnings: Warning[]
 * }} Status
 */

/**
 * One contact: its axes are standard deviations of the pressure, its angle goes from x towards y.
 * @typedef {{
 *   id: number, x_mm: number, y_mm: number, force: number, area_mm2: number, peak: number, major_mm: number,
 *   minor_mm: number, angle_rad: number, cut_off?: boolean, force_deviation?: number|null
 * }} Contact
 */

/** @typedef {{type: "contacts", sequence: number, timestamp: number, unit: string, contacts: Contact[]}} ContactsMessage strongest first */

/**
 * @typedef {object} Listener
 * @property {(images: Packet[]) => void} onImages of one frame, each at the place of its kind; the views die with
 *   the call
 * @property {(status: Status) => void} onStatus
 * @property {() => void} onLink the link's state changed
 * @property {(message: ContactsMessage) => void} onContacts
 */

const NEXT = JSON.stringify({ type: "next" });

export class SensorStream extends ReconnectingSocket {
  /**
   * @param {string} url
   * @param {number[]} kinds of image that the address asks for
   * @param {Listener} listener
   */
  constructor(url, kinds, listener) {
    super(url);
    /** Since when a frame has been waited for, ms on performance.now's clock; 0 when none is. */
    this.requestedAt = 0;
    this._requested = 0; // frames that have not come yet
    this._listener = listener;
    this._kinds = kinds;
    this._images = KIND_NAMES.map(() => packet());
    this.open();
  }

  /**
   * Ask for frames until so many are under way.
   * @param {number} count at most two: the service holds no more ready
   */
  next(count) {
    if (this.link !== "open" || this._requested >= count) return;
    if (!this._requested) this.requestedAt = performance.now();
    for (; this._requested < count; this._requested += 1) this.send(NEXT);
  }

  /** Go on with another address. @param {string} url @param {number[]} kinds of image that it asks for */
  move(url, kinds) {
    this._kinds = kinds;
    this.moveTo(url);
  }

  /** @override @param {ArrayBuffer|string} data */
  take(data) {
    if (typeof data === "string") this._takeText(JSON.parse(data));
    else this._takeImage(new Uint8Array(data));
  }

  /** @override */
  forget() {
    this.requestedAt = this._requested = 0;
    this._forgetParts();
  }

  /** @override */
  changed() {
    this._listener.onLink();
  }

  /** @param {Status|ContactsMessage} message */
  _takeText(message) {
    if (message.type === "contacts") {
      this._listener.onContacts(message);
    } else if (message.type === "status") {
      this.attempts = 0;
      this._listener.onStatus(message);
    }
  }

  /** @param {Uint8Array} bytes */
  _takeImage(bytes) {
    const kind = kindOf(bytes);
    if (!this._kinds.includes(kind)) throw new RangeError(`an image of kind ${kind} was not requested`);
    const one = parse(bytes, this._images[kind]);
    this.attempts = 0;
    for (let i = 0; i < this._kinds.length; i += 1) {
      if (this._images[this._kinds[i]].sequence !== one.sequence) return;
    }
    this._requested -= 1;
    this.requestedAt = this._requested ? this.lastMessageAt : 0;
    this._listener.onImages(this._images);
    this._forgetParts();
  }

  /** An image seen so far is no part of a frame still to come. */
  _forgetParts() {
    for (let i = 0; i < this._images.length; i += 1) this._images[i].sequence = -1;
  }
}
