/** A sensor's frames in a recording, watched in the place of its stream. @module */

import * as api from "../wire/api.js";
import { FrameHistory } from "../wire/frame_history.js";
import { messageOf, notice } from "../shell/notice.js";
import { PlaybackClock, rateOf, splitFrames, stepOf } from "./playback_clock.js";
import { Timeline } from "../shell/timeline.js";
import { unitOf } from "../shell/units.js";
import { KIND_NAMES, PRESSURES, TRACTION, kindOf, messageBytes, packet, parse } from "../wire/wire.js";

/** @import { Played, PlayedFrame } from "../wire/api.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Plane } from "../maps/geometry.js" */
/** @import { Health } from "../shell/health.js" */
/** @import { ContactsMessage, Status } from "../wire/sensor_stream.js" */

/**
 * @typedef {{number: number, position: number, messages: Uint8Array[]}} Fetched a frame that is not shown yet
 */

const CHUNK = 48; // frames an answer while it plays
const DETAILS_MS = 500; // between two requests for warnings while it plays
const CONTACTS_CHUNK = 24; // frames an answer on contacts while it plays
const SAME_S = 1e-4; // between two times of one frame
const BUSY_MS = 1000; // until a request is repeated that came too soon, or for what is not read yet
/** @type {Health} */
const PLAYBACK = { level: "playback", title: "", text: "" };

export class PlaybackSession {
  /**
   * @param {string} name
   * @param {Plane} plane
   * @param {number[]} kinds of image that the sensor has
   * @param {boolean} contacts whether they are requested
   * @param {boolean} shear whether it is requested, if so
   * @param {Played} recorded
   * @param {{onFrame: (frame: Frame) => void, onChange: () => void}} listener
   */
  constructor(name, plane, kinds, contacts, shear, recorded, listener) {
    this.name = name;
    this.plane = plane;
    this.kinds = kinds;
    this.recorded = recorded;
    this.history = new FrameHistory(plane, kinds);
    this.unit = unitOf(recorded.unit);
    /** Which frame is shown, or is about to be. */
    this.number = 0;
    /** s, of that frame. */
    this.position = 0;
    this.clock = new PlaybackClock();
    this.loop = false;
    this.method = "";
    /** @type {Status|null} of the frame nearest to the one that is shown */
    this.status = null;
    /** @type {Timeline<ContactsMessage>} */
    this.contacts = new Timeline(2 * CHUNK, SAME_S);
    /** @type {Timeline<Status>} */
    this._statuses = new Timeline(64, SAME_S);
    // What a live session has beside, at rest.
    this.deviations = { request() {}, at: (/** @type {number} */ _timestamp) => null };
    this.freshness = { minDelay: Infinity, heldBack: 0 };
    this.stream = { link: "open", retry() {} };
    this._asked = shear ? kinds : PRESSURES;
    this._finds = contacts;
    this._finding = false;
    this._found = -1; // number of the last frame whose contacts came while it played
    this._listener = listener;
    /** @type {Fetched[]} */
    this._queue = [];
    this._turn = 0; // counts up with every seek, so that what was requested before is dropped
    this._fetching = this._asking = false;
    this._sought = true; // the frame to be shown is not the one that is due, but another
    this._next = 0; // number of the frame to be fetched next
    /** @type {number|null} s, instead of `_next` */
    this._seekTo = null;
    this._detailsAt = 0;
    this._answer_ms = 0; // that the newest details took
    this._detailed = -1; // number of the frame whose details came last
    /** @type {Health} */
    this._health = PLAYBACK;
    this._stopped = false;
    this._packets = KIND_NAMES.map(() => packet());
    this._tick = this._tick.bind(this);
    requestAnimationFrame(this._tick);
  }

  /** @returns {boolean} the picture stands still */
  get paused() {
    return !this.clock.playing;
  }

  /** @returns {Frame|null} the one that is shown */
  get frame() {
    return this.history.at(0);
  }

  /** @returns {number} how many frames before the last */
  get back() {
    return Math.max(0, this.recorded.frames - 1 - this.number);
  }

  /** @returns {Status|null} */
  get statusOfFrame() {
    const { frame } = this;
    return frame && this._statuses.at(frame.timestamp);
  }

  /** @returns {Health} */
  health() {
    return this._health;
  }

  stop() {
    this._stopped = true;
    this._turn += 1;
  }

  painted() {}

  holdBack() {
    return false;
  }

  /** @param {boolean} contacts @param {boolean} shear whether they are requested from now on */
  ask(contacts, shear) {
    this._finds = contacts;
    this._asked = shear ? this.kinds : PRESSURES;
    this._seek(this.number);
  }

  /** Restore by another method, for this page only. @param {string} method */
  restoreBy(method) {
    this.method = method;
    this._seek(this.number);
  }

  /** @param {boolean} to */
  pause(to) {
    const now = performance.now();
    if (!to && this._next >= this.recorded.frames && !this.recorded.reading) this._seek(0);
    this.clock.play(!to, now);
    this.setSpeed(this.clock.speed);
    this._detailed = -1;
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.clock.setSpeed(speed, performance.now());
    this._statuses.setWithin(this.paused ? SAME_S : Math.max(1, speed));
    this._found = -1;
    this._queue.length = 0;
    this._next = this._sought ? this.number : this.number + 1;
    this._turn += 1;
  }

  /** Show another frame. @param {number} to how far before the last */
  show(to) {
    this._seek(Math.max(0, Math.min(this.recorded.frames - 1, this.recorded.frames - 1 - to)));
  }

  /** Show the frame at a position. @param {number} position s */
  showAt(position) {
    this._seek(this.number);
    this._seekTo = Math.max(0, position);
  }

  /** More of the recording was read. @param {Played} recorded */
  update(recorded) {
    this.recorded = recorded;
    if (this.status) this.status.rate_hz = rateOf(recorded);
    this._listener.onChange();
  }

  /** @param {number} number of a frame */
  _seek(number) {
    this.number = this._next = number;
    this._seekTo = null;
    this._queue.length = 0;
    this._turn += 1;
    this._sought = true;
    this._detailed = this._found = -1;
    this.contacts.clear();
    this._statuses.clear();
  }

  /** The screen's turn. @param {number} now */
  _tick(now) {
    if (this._stopped) return;
    if (this.clock.playing && !this._sought) this._play(now);
    else if (this._queue.length) this._present(/** @type {Fetched} */ (this._queue.shift()), now);
    const { frames, reading } = this.recorded;
    const wanted = this._sought || (this.clock.playing && this._queue.length < CHUNK / 2);
    if (wanted && !this._fetching && (this._next < frames || this._seekTo !== null)) this._fetch();
    if (this.clock.playing && !reading && this._next >= frames && !this._queue.length && !this._sought && !this._fetching) this._end(now);
    this._details(now);
    this._find();
    requestAnimationFrame(this._tick);
  }

  /** Show the frame that is due. @param {number} now */
  _play(now) {
    const position = this.clock.at(now);
    let due = 0;
    while (due < this._queue.length && this._queue[due].position <= position) due += 1;
    if (due) this._present(this._queue.splice(0, due)[due - 1], now, false);
    else if (!this._queue.length) this.clock.seek(this.position, now); // it waits for the service
  }

  /** @param {number} now */
  _end(now) {
    if (this.loop && this.recorded.frames > 1) this._seek(0);
    else this.clock.play(false, now);
    this._listener.onChange();
  }

  /** @param {Fetched} fetched @param {number} now @param {boolean} [sought] the clock follows it */
  _present({ number, position, messages }, now, sought = true) {
    this.number = number;
    this.position = position;
    if (sought) {
      this.clock.seek(position, now);
      this._sought = false;
    }
    const kinds = messages.map(kindOf);
    messages.forEach((each, i) => parse(each, this._packets[kinds[i]]));
    if (!this.history.fits(this._packets, kinds)) return;
    const frame = this.history.push(this._packets, kinds);
    this.unit = frame.unit;
    this._listener.onFrame(frame);
    if (this.paused) this._listener.onChange();
  }

  async _fetch() {
    this._fetching = true;
    const turn = this._turn;
    const { name, recorded, clock, method } = this;
    const step = clock.playing ? stepOf(recorded.frames, recorded.duration_s, clock.speed) : 1;
    const kinds = this._asked.length;
    /** @type {Record<string, string|number|boolean>} */
    const query = { sensor: name, count: clock.playing ? CHUNK : 1, step, shear: kinds > PRESSURES.length, traction: this._asked.includes(TRACTION) };
    if (method) query.method = method;
    if (this._seekTo === null) query.first = this._next;
    else query.at = this._seekTo;
    try {
      const { first, positions, bytes } = await api.recordedFrames(recorded.name, query);
      this._health = PLAYBACK;
      if (turn !== this._turn) return;
      this._seekTo = null;
      splitFrames(bytes, kinds, messageBytes).forEach((messages, n) =>
        this._queue.push({ number: first + n * step, position: positions[n], messages }));
      this._next = first + positions.length * step;
    } catch (error) {
      await this._fail(error, turn);
    } finally {
      this._fetching = false;
    }
  }

  /** A request failed: try again, or say why not, unless it is of no use any more. @param {unknown} error @param {number} turn of the request */
  async _fail(error, turn) {
    if (turn !== this._turn) return;
    const status = error instanceof api.ApiError ? error.status : -1;
    if (status === 0) this._health = { level: "disconnected", title: "DISCONNECTED", text: "The service does not answer. Retrying." };
    else if (status !== 429 && status !== 409) {
      notice(`${this.recorded.name}: ${messageOf(error)}`, true);
      this.clock.play(false, performance.now());
      this._sought = false;
    }
    this._listener.onChange();
    await new Promise((resolve) => { setTimeout(resolve, BUSY_MS); });
  }

  /** Ask for the contacts of the frames that are shown next, while it plays. */
  async _find() {
    const [next] = this._queue;
    if (!this._finds || this._finding || !this.clock.playing || this._sought || !next) return;
    const { name, recorded, clock, method, _turn: turn } = this;
    const step = stepOf(recorded.frames, recorded.duration_s, clock.speed);
    const first = Math.max(next.number, this._found + step);
    const count = Math.min(CONTACTS_CHUNK, Math.floor((this._queue[this._queue.length - 1].number - first) / step) + 1);
    if (count < Math.min(CONTACTS_CHUNK, this._queue.length) / 2) return;
    this._finding = true;
    try {
      /** @type {Record<string, string|number|boolean>} */
      const query = { sensor: name, first, count, step };
      const { frames } = await api.recordedContacts(recorded.name, method ? { ...query, method } : query);
      if (turn !== this._turn) return;
      for (const { number, ...found } of frames) {
        this.contacts.push({ type: "contacts", unit: recorded.unit, ...found });
        this._found = number;
      }
    } catch (error) {
      await this._fail(error, turn);
    } finally {
      this._finding = false;
    }
  }

  /** Ask for warnings, and in a pause for contacts, of the frame that is shown, or soon will be. @param {number} now */
  async _details(now) {
    const { name, recorded, clock, method, _turn: turn } = this;
    const ahead = clock.playing ? this._queue.find((each) => each.position >= clock.at(now) + (clock.speed * this._answer_ms) / 1000) : null;
    const number = ahead?.number ?? this.number;
    if (this._asking || this._sought || !this.frame || number === this._detailed) return;
    if (clock.playing && now - this._detailsAt < DETAILS_MS) return;
    this._asking = true;
    this._detailsAt = now;
    try {
      const details = await api.recordedFrame(recorded.name, name, number, method);
      this._health = PLAYBACK;
      this._answer_ms = performance.now() - now;
      if (turn !== this._turn) return;
      this._take(details, method);
      this._detailed = this.paused && number !== this.number ? -1 : number;
    } catch (error) {
      await this._fail(error, turn);
    } finally {
      this._asking = false;
    }
  }

  /** @param {PlayedFrame} details @param {string} method that was asked for */
  _take(details, method) {
    const { unit } = this.recorded;
    if (this.paused) this.contacts.push({ type: "contacts", sequence: details.sequence, timestamp: details.timestamp, unit, contacts: details.contacts });
    this.status = {
      ...details, type: "status", sensor: this.name, state: "live", age_s: null, rate_hz: rateOf(this.recorded), jitter_s: null, detail: "",
      method, ran: details.method, calibration: this.recorded.calibration,
    };
    this._statuses.push(this.status);
    this._listener.onChange();
  }
}
