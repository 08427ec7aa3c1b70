/** One sensor as it is watched: its stream, the frames that are kept, and which of them is shown. @module */

import * as api from "./api.js";
import { Contacts } from "./contacts.js";
import { DeviationCache } from "./deviation.js";
import { FrameHistory } from "./frame_history.js";
import { Freshness } from "./freshness.js";
import { healthOf } from "./health.js";
import { SensorStream } from "./sensor_stream.js";
import { Timeline } from "./timeline.js";
import { RAW, RESTORED, SHEAR } from "./wire.js";

/** @import { Frame } from "./frame_history.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { Health } from "./health.js" */
/** @import { Status } from "./sensor_stream.js" */
/** @import { Packet } from "./wire.js" */

/**
 * @typedef {object} Listener
 * @property {(frame: Frame, anew: boolean) => void} onFrame a frame came that may be shown; the first after a while?
 * @property {(status: Status, changed: boolean) => void} onStatus
 * @property {() => void} onLink
 * @property {() => void} onContacts contacts of a frame came
 * @property {() => void} onOther the sensor has another shape than was believed
 */

const PRESSURE_KINDS = [RAW, RESTORED];
const ALL_KINDS = [RAW, RESTORED, SHEAR];
const MAX_UNPAINTED = 2; // frames under way or not painted: with one, each would wait for the asking to cross the network
const MAX_STATUSES = 128; // statuses: more than ten seconds, at ten a second
const STATUS_WITHIN_S = 1; // between the frame that a status is of and one that it is shown with
const MAX_GAP_S = 60; // between a frame and the next, from which they are not of one play

export class Session {
  /**
   * @param {string} name
   * @param {Plane} plane
   * @param {boolean} hasShear shear
   * @param {boolean} contacts whether they are asked for, too
   * @param {boolean} shear whether it is asked for, too, where the skin feels it
   * @param {Listener} listener
   */
  constructor(name, plane, hasShear, contacts, shear, listener) {
    this.name = name;
    this.plane = plane;
    this.hasShear = hasShear;
    this.history = new FrameHistory(plane, hasShear);
    this.contacts = new Contacts();
    /** @type {Timeline<Status>} */
    this._statuses = new Timeline(MAX_STATUSES, STATUS_WITHIN_S);
    this.deviations = new DeviationCache(name, plane);
    this.freshness = new Freshness();
    this.paused = false;
    /** Which kept frame is shown, 0 the newest. */
    this.back = 0;
    /** @type {Status|null} */
    this.status = null;
    this._statusAt = 0;
    this._frameAt = 0;
    this._unpainted = 0; // frames that came since the last painting
    this._listener = listener;
    this._shear = hasShear && shear;
    this.stream = new SensorStream(api.streamUrl(name, contacts, this._shear), this._shear ? ALL_KINDS : PRESSURE_KINDS, {
      onImages: (images) => this._take(images),
      onStatus: (status) => this._takeStatus(status),
      onLink: () => this._linked(),
      onContacts: (found) => {
        if (this.paused) return;
        this.contacts.push(found);
        this._listener.onContacts();
      },
    });
  }

  /** @returns {Frame|null} the one that is shown */
  get frame() {
    return this.history.at(this.back + this.freshness.heldBack);
  }

  /**
   * @returns {Status|null} while paused what was told of the frame that is shown, or of the one nearest in time; null where
   *   none is near; else the newest
   */
  get statusOfFrame() {
    const { frame } = this;
    return this.paused && frame ? this._statuses.at(frame.timestamp) : this.status;
  }

  /** @returns {Health} */
  health() {
    return healthOf(this.stream, this.status, this._statusAt, this._frameAt);
  }

  /** Watch no longer. */
  stop() {
    this.stream.stop();
  }

  /**
   * @param {boolean} contacts whether they are asked for from now on
   * @param {boolean} shear whether it is, where the skin feels it
   */
  ask(contacts, shear) {
    this._shear = this.hasShear && shear;
    this.stream.move(api.streamUrl(this.name, contacts, this._shear), this._shear ? ALL_KINDS : PRESSURE_KINDS);
  }

  /** @param {boolean} to */
  pause(to) {
    this.paused = to;
    this.freshness.shown(); // while paused every frame that is kept may be
    if (to) return;
    this.back = 0;
    this._request();
  }

  /** Show another kept frame; the picture stands still from then on. @param {number} to how far back */
  show(to) {
    if (!this.history.length) return;
    this.pause(true);
    this.back = Math.max(0, Math.min(this.history.length - 1, to));
  }

  /** What came is on the screen. */
  done() {
    this.freshness.painted();
    this._unpainted = 0;
    this._request();
  }

  /**
   * Hold back what came but waited too long, and ask for newer frames. Of a sensor that is not live it is the newest
   * there is, and the page says how old.
   * @returns {boolean} false where it may be shown
   */
  holdBack() {
    const newest = this.history.at(0);
    if (!newest || !this._unpainted || this.paused || this.status?.state !== "live") return false;
    if (!this.freshness.holdBack(newest.sent, this._unpainted)) return false;
    this._unpainted = 0;
    this._request();
    return true;
  }

  /** Ask for what may be under way. */
  _request() {
    if (!this.paused) this.stream?.next(MAX_UNPAINTED - this._unpainted); // it tells of its first link while it is being made
  }

  /** @param {Packet[]} images */
  _take(images) {
    if (this.paused) return;
    const raw = images[RAW];
    const restored = images[RESTORED];
    const shear = this._shear ? images[SHEAR] : null;
    if (!this.history.fits(raw, restored, shear)) {
      this._listener.onOther();
      return;
    }
    const newest = this.history.at(0);
    if (newest && (restored.timestamp < newest.timestamp || restored.timestamp > newest.timestamp + MAX_GAP_S)) {
      this.history.clear();
      this.contacts.clear();
      this._statuses.clear();
      this.deviations.clear();
    }
    this._frameAt = performance.now();
    this._unpainted += 1;
    this.freshness.arrived(restored.sent);
    const frame = this.history.push(raw, restored, shear);
    if (this.holdBack()) return;
    const resumed = this.freshness.heldBack > 0;
    this.freshness.shown();
    this._listener.onFrame(frame, resumed);
  }

  /** @param {Status} status */
  _takeStatus(status) {
    const changed = this.status?.state !== status.state || this.status?.method !== status.method;
    this.status = status;
    this._statusAt = performance.now();
    if (status.ran && !this.paused) this._statuses.push(status);
    const newest = this.history.at(0);
    if (newest && status.state !== "live" && this.freshness.heldBack) {
      this.freshness.shown();
      this._listener.onFrame(newest, true);
    }
    this._listener.onStatus(status, changed);
  }

  _linked() {
    this._request();
    this._listener.onLink();
  }
}
