/** One sensor as it is watched: its stream, the frames that are kept, and which of them is shown. @module */

import * as api from "./api.js";
import { ContactSeries } from "../charts/contact_series.js";
import { DeviationCache } from "../maps/deviation.js";
import { FrameHistory } from "./frame_history.js";
import { Freshness } from "../shell/freshness.js";
import { healthOf } from "../shell/health.js";
import { SensorStream } from "./sensor_stream.js";
import { Timeline } from "../shell/timeline.js";
import { unitOf } from "../shell/units.js";
import { PRESSURES, RESTORED } from "./wire.js";

/** @import { Frame } from "./frame_history.js" */
/** @import { Plane } from "../maps/geometry.js" */
/** @import { Health } from "../shell/health.js" */
/** @import { ContactsMessage, Status } from "./sensor_stream.js" */
/** @import { Packet } from "./wire.js" */

/**
 * @typedef {object} Listener
 * @property {(frame: Frame, resumed: boolean) => void} onFrame a frame that may be shown; the first after some were held back?
 * @property {(status: Status, changed: boolean) => void} onStatus
 * @property {() => void} onCalibration another calibration was applied
 * @property {() => void} onLink
 * @property {() => void} onContacts contacts of a frame came
 * @property {() => void} onOtherShape the sensor has another shape than before, or was restarted
 */

const MAX_UNPAINTED = 2; // frames under way or not painted: with one, each would wait for a request to cross the network
const MAX_STATUSES = 128; // more than ten seconds at ten a second
const STATUS_WITHIN_S = 1; // of the frame that it is shown with
const MAX_CONTACTS = 256; // messages: more than ten seconds at twenty a second
const CONTACTS_WITHIN_S = 0.25; // of a live frame,
const HALF_LOOK_S = 0.03; // and of one that stands still: from a frame to the next of the service's looks, 20 a second
const PAUSED_WITHIN_S = 0.15; // of the newest frame: what a pause shows for the sake of contacts
const MAX_GAP_S = 60; // between two frames of one run

export class Session {
  /**
   * @param {string} name
   * @param {Plane} plane
   * @param {number[]} kinds of image that the sensor has
   * @param {boolean} contacts whether they are requested, too
   * @param {boolean} shear whether it is requested, too, if the skin measures it
   * @param {Listener} listener
   */
  constructor(name, plane, kinds, contacts, shear, listener) {
    this.name = name;
    this.plane = plane;
    this.kinds = kinds;
    this.history = new FrameHistory(plane, kinds);
    /** @type {Timeline<ContactsMessage>} */
    this.contacts = new Timeline(MAX_CONTACTS, CONTACTS_WITHIN_S);
    /** Of all contacts that came, those of a paused page too. */
    this.series = new ContactSeries();
    /** @type {Timeline<Status>} */
    this._statuses = new Timeline(MAX_STATUSES, STATUS_WITHIN_S);
    this.deviations = new DeviationCache(name, plane.restored.count);
    this.freshness = new Freshness();
    this.paused = false;
    this._settles = false; // a pause has just begun: contacts of kept frames may still come
    /** Unit of the kept frames' pressure, index in UNITS; before the first one as the list of sensors has it. */
    this.unit = 0;
    /** Which kept frame is shown, 0 the newest. */
    this.back = 0;
    /** @type {Status|null} */
    this.status = null;
    this._statusAt = 0;
    this._frameAt = 0;
    this._unpainted = 0; // frames that came since the last painting
    this._sequence = -1; // the newest that was reported
    this._restarted = false; // since the first frame: places and cover may be others
    this._listener = listener;
    this._asked = shear ? kinds : PRESSURES;
    this.stream = new SensorStream(api.streamUrl(name, contacts, this._asked), this._asked, {
      onImages: (images) => this._take(images),
      onStatus: (status) => this._takeStatus(status),
      onLink: () => this._linked(),
      onContacts: (message) => {
        this.series.push(message);
        if (unitOf(message.unit) !== this.unit || (this.paused && message.timestamp > this.newest)) return;
        this.contacts.push(message);
        if (this._settles) this.back = this._withContacts(this.back);
        this._listener.onContacts();
      },
    });
  }

  /** @returns {Frame|null} the one that is shown */
  get frame() {
    return this.history.at(this.back + this.freshness.heldBack);
  }

  /** @returns {number} Unix s, of the newest kept frame; 0 for none */
  get newest() {
    return this.history.at(0)?.timestamp ?? 0;
  }

  /** @returns {number|null} Unix s, where series end in a pause; null where they go on */
  get until() {
    return this.paused ? this.newest : null;
  }

  /** @returns {Status|null} of the frame that is shown still, or the nearest in time; else the newest */
  get statusOfFrame() {
    const { frame } = this;
    return this.paused && frame ? this._statuses.at(frame.timestamp) : this.status;
  }

  /** @returns {Health} */
  health() {
    return healthOf(this.stream, this.stream, this.status, this._statusAt, this._frameAt, performance.now());
  }

  /** Watch no longer. */
  stop() {
    this.stream.stop();
  }

  /**
   * @param {boolean} contacts whether they are requested from now on
   * @param {boolean} shear whether it is, if the skin measures it
   */
  ask(contacts, shear) {
    this._asked = shear ? this.kinds : PRESSURES;
    this.stream.move(api.streamUrl(this.name, contacts, this._asked), this._asked);
  }

  /** @param {boolean} to stand still, at the newest frame or the one before it whose contacts have come */
  pause(to) {
    if (to && !this.paused) this.back = this._withContacts();
    this.paused = this._settles = to;
    this.contacts.setWithin(to ? HALF_LOOK_S : CONTACTS_WITHIN_S);
    this.freshness.release(); // while paused every frame that is kept may be
    if (to) return;
    this.back = 0;
    this._request();
  }

  /** @param {number} [other] if none came of late @returns {number} how far back the frame of the newest contacts is */
  _withContacts(other = 0) {
    const { contacts: { newest }, history } = this;
    if (!newest?.contacts.length || newest.timestamp < this.newest - PAUSED_WITHIN_S) return other;
    for (let back = 0; back < history.length; back += 1) if (history.at(back)?.sequence === newest.sequence) return back;
    return other;
  }

  /** Show another kept frame; the picture stands still from then on. @param {number} to how far back */
  show(to) {
    if (!this.history.length) return;
    this.pause(true);
    this._settles = false;
    this.back = Math.max(0, Math.min(this.history.length - 1, to));
  }

  /** The newest frame is on the screen. */
  painted() {
    this.freshness.painted();
    this._unpainted = 0;
    this._request();
  }

  /**
   * Hold back what came but waited too long, and ask for newer frames. If the service has none, the late frame is
   * shown; the latency reading says how old it was.
   * @returns {boolean} false where it may be shown
   */
  holdBack() {
    const newest = this.history.at(0);
    if (!newest || !this._unpainted || this.paused || this.status?.state !== "live") return false;
    if (!this.freshness.holdBack(newest.sent, this._unpainted, Date.now() / 1000)) return false;
    this._unpainted = 0;
    this._request();
    return true;
  }

  /** Ask for what may be under way. */
  _request() {
    if (!this.paused) this.stream?.next(MAX_UNPAINTED - this._unpainted); // undefined while its constructor connects
  }

  /** @param {Packet[]} images */
  _take(images) {
    const restored = images[RESTORED];
    this._follow(restored.sequence);
    if (this.paused) return;
    const newest = this.history.at(0);
    if (this._restarted || !this.history.fits(images, this._asked)) {
      this._listener.onOtherShape();
      return;
    }
    const other = restored.unit !== this.unit; // a calibration was applied
    this.unit = restored.unit;
    if (newest && (other || restored.timestamp < newest.timestamp || restored.timestamp > newest.timestamp + MAX_GAP_S)) {
      this.history.clear();
      this.contacts.clear();
      this._statuses.clear();
      this.deviations.clear();
    }
    this._frameAt = performance.now();
    this._unpainted += 1;
    this.freshness.arrived(restored.sent, Date.now() / 1000);
    const frame = this.history.push(images, this._asked);
    if (this.holdBack()) return;
    const resumed = this.freshness.heldBack > 0;
    this.freshness.release();
    this._listener.onFrame(frame, resumed);
  }

  /** @param {number} sequence of the sensor's newest frame, as a message has it: none comes before that of an older one */
  _follow(sequence) {
    if (sequence < this._sequence) this._restarted = true;
    this._sequence = sequence;
  }

  /** @param {Status} status */
  _takeStatus(status) {
    this._follow(status.sequence ?? -1);
    const changed = this.status?.state !== status.state || this.status?.method !== status.method;
    const recalibrated = this.status && this.status.calibration !== status.calibration;
    this.status = status;
    this._statusAt = performance.now();
    if (status.ran && !this.paused) this._statuses.push(status);
    const newest = this.history.at(0);
    if (newest && this.freshness.noneNewer(status, newest.sequence, Date.now() / 1000)) {
      this.freshness.release();
      this._listener.onFrame(newest, true);
    }
    this._listener.onStatus(status, changed);
    if (recalibrated) this._listener.onCalibration();
  }

  _linked() {
    this._request();
    this._listener.onLink();
  }
}
