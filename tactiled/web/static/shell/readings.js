/** The side panel's numbers and texts. @module */

import { byId, element, setText } from "./dom.js";
import { fixed, number } from "./format.js";
import { measures } from "../maps/measures.js";
import { FORCE_UNITS, forceNumber, forceText, lengthNumber, lengthText, pressureText } from "./units.js";
import { Alerts } from "./warnings.js";

/** @import { Loss, Sensor } from "../wire/api.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Measures } from "../maps/measures.js" */
/** @import { Status } from "../wire/sensor_stream.js" */

/** What each method is called. */
const METHOD_TITLES = {
  auto: "Automatic", raw: "None, as measured", wiener: "Wiener filter", rl: "Richardson–Lucy",
  "rl-fast": "Richardson–Lucy", nnls: "Non-negative (NNLS)",
  tv: "Non-negative, total variation", points: "A few points", learned: "Learned network",
  idle: "idle",
};

/** What is counted, by unit. */
const LOSSES = /** @type {const} */ ({
  messages: [
    ["lost", "lost", "never came"],
    ["late", "late", "came out of order"],
    ["repeated", "repeated", "came twice"],
    ["malformed", "malformed", "the codec cannot decode them"],
    ["foreign", "foreign", "on the bus, but of no sensor"],
    ["dropped", "dropped", "dropped by the kernel, as they were not read in time"],
  ],
  frames: [
    ["incomplete", "incomplete", "published with taxels missing"],
    ["skipped", "skipped", "not restored, because a newer one was there"],
  ],
  "on the bus": [
    ["errors", "error frames", "what the bus interface says went wrong on the wire"],
    ["bus_off", "bus-off", "times that the bus interface left the bus because of errors"],
    ["unsent", "unsent", "messages to sensors that the bus did not accept"],
    ["unreadable", "unreadable", "messages that the bus interface could not decode"],
    ["undelivered", "undelivered", "images that did not come from the sensor's reader, or were overtaken"],
  ],
});

/** Counts that belong to a healthy service: a shared bus, a frame overtaken by the next. */
const HARMLESS_LOSSES = new Set(["foreign", "skipped"]);

const NO_MEASURES = measures();

/** @param {string} name @returns {string} */
export const methodTitle = (name) => METHOD_TITLES[/** @type {keyof METHOD_TITLES} */ (name)] ?? name;

export class Readings {
  constructor() {
    /** @type {Map<string, HTMLElement>} */
    this._loss = new Map();
    for (const [unit, kinds] of Object.entries(LOSSES)) byId("loss").append(...this._counts(unit, kinds));
    this._errorKinds = element("p", "sub");
    this._errorKinds.title = "Kinds of error frames";
    byId("loss").append(this._errorKinds);
    this._alerts = new Alerts(byId("alerts"));
    this._raw = measureCells("raw");
    this._restored = measureCells("restored");
    this._at = Object.fromEntries([
      "method-used", "why", "iterations", "microseconds", "cut-short", "resolution", "noise", "noise-gain", "about", "sequence", "rate",
      "fps", "latency", "jitter", "skew", "losses",
    ].map((id) => [id, byId(id)]));
    this._offset = byId("details-from");
    /** @type {Status|null} */
    this._status = null;
    this._live = false;
  }

  /**
   * @param {string} unit
   * @param {readonly (readonly [string, string, string])[]} kinds key, name, meaning
   * @returns {HTMLElement[]} a heading and a list
   */
  _counts(unit, kinds) {
    const list = element("dl", "grid");
    for (const [kind, title, meaning] of kinds) {
      const name = element("dt", "", title);
      const value = element("dd", "", "\u2013");
      name.title = meaning;
      list.append(name, value);
      this._loss.set(kind, value);
    }
    return [element("h4", "", unit), list];
  }

  /** @param {Sensor} sensor */
  about(sensor) {
    const errors = Object.entries(sensor.error_kinds).filter(([, count]) => count);
    setText(this._errorKinds, errors.map(([kind, count]) => `${kind.replaceAll("_", " ")} ${count}`).join(", "));
    const size = sensor.rows ? `${sensor.rows} × ${sensor.columns}` : `${sensor.taxels} taxels`;
    setText(this._at.about, `${size}, ${number(sensor.pitch_mm)} mm, ${sensor.bus}`);
    this._at.about.title = `${sensor.taxels} taxels at a pitch of ${number(sensor.pitch_mm)} mm, codec ${sensor.codec}, bus ${sensor.bus}`;
  }

  /** @param {Frame|null} frame */
  frame(frame) {
    const at = this._at;
    const unit = frame?.unit ?? 0;
    const idle = frame?.method === "idle";
    showMeasures(this._raw, frame ? frame.ofRaw : NO_MEASURES, unit, idle);
    showMeasures(this._restored, frame ? frame.ofRestored : NO_MEASURES, unit, idle);
    for (const [kind, of] of /** @type {const} */ ([["raw", frame?.ofRaw], ["restored", frame?.ofRestored]])) {
      setText(byId(`${kind}-caption`), of ? `${idle ? `${idleForce(of.force, unit)} ${FORCE_UNITS[unit]}` : forceText(of.force, unit)}, peak ${pressureText(of.peak, unit)}` : "");
    }
    setText(at.iterations, frame ? String(frame.iterations) : "\u2013");
    setText(at.microseconds, frame ? time(frame.microseconds) : "\u2013");
    setText(at.resolution, frame && frame.method !== "idle" ? lengthText(frame.resolutionMm) : "\u2013");
    setText(at.noise, frame ? pressureText(frame.noise, unit, 2) : "\u2013");
    setText(at["noise-gain"], frame ? `× ${number(frame.noiseGain)}` : "\u2013");
    setText(at.sequence, frame ? String(frame.sequence) : "\u2013");
  }

  /** @param {Status|null} status @param {boolean} live the status still holds */
  status(status, live) {
    if (status && status === this._status && live === this._live) return;
    this._status = status;
    this._live = live;
    const at = this._at;
    setText(at.rate, status && live ? `${fixed(status.rate_hz, 1)} Hz` : "\u2013");
    setText(at.jitter, time((status?.jitter_s ?? NaN) * 1e6));
    setText(at.skew, time((status?.skew_s ?? NaN) * 1e6));
    let losses = 0;
    for (const [kind, element] of this._loss) {
      const count = status ? status.loss[/** @type {keyof Loss} */ (kind)] : 0;
      setText(element, status ? String(count) : "\u2013");
      const harmful = count > 0 && !HARMLESS_LOSSES.has(kind);
      element.classList.toggle("some", harmful);
      if (harmful) losses += count;
    }
    setText(at.losses, !status ? "\u2013" : losses ? String(losses) : "none");
    at.losses.classList.toggle("some", losses > 0);
  }

  /**
   * How the image that is shown was restored.
   * @param {string} method that was used; "" where it is not known
   * @param {Status|null} status of this image, or of another
   * @param {string} offset in time, where it is of another
   * @param {boolean} still the image does not change: warnings of others are dropped
   */
  restoration(method, status, offset, still) {
    setText(this._at["method-used"], method ? methodTitle(method) : "\u2013");
    setText(this._at.why, status && status.ran === method ? status.why : "");
    setText(this._at["cut-short"], !status ? "\u2013" : status.warnings.some((each) => each.code === "cut_short") ? "yes" : "no");
    setText(this._offset, offset);
    if (still || status?.sensor !== this._status?.sensor) this._alerts.clear();
    this._alerts.show(status?.warnings ?? null, performance.now());
  }

  /**
   * @param {number} fps
   * @param {number} latency_ms NaN where the picture is not live
   * @param {number} skew_s how far the two clocks are apart, s; 0 where they agree
   */
  pace(fps, latency_ms, skew_s) {
    setText(this._at.fps, `${fixed(fps, 0)} fps`);
    setText(this._at.latency, Number.isFinite(latency_ms) ? `${fixed(latency_ms, 0)} ms` : "\u2013");
    this._at.latency.title = skew_s
      ? `This browser's clock is ${fixed(skew_s, 1)} s off the service's: the way over the network is left out` : "";
  }
}

/** @param {"raw"|"restored"} kind */
const measureCells = (kind) =>
  ({ force: byId(`force-${kind}`), peak: byId(`peak-${kind}`), at: byId(`peak-at-${kind}`), x: byId(`x-${kind}`), y: byId(`y-${kind}`) });

/** @param {number} force @param {number} unit of pressure @returns {string} of noise alone */
const idleForce = (force, unit) => fixed(force, unit ? 0 : 2);

/**
 * @param {ReturnType<typeof measureCells>} at cells to fill
 * @param {Measures} of an image
 * @param {number} unit of its pressure
 * @param {boolean} idle nothing but noise: its small digits say nothing
 */
function showMeasures(at, of, unit, idle) {
  setText(at.force, idle ? idleForce(of.force, unit) : forceNumber(of.force, unit));
  setText(at.peak, number(of.peak));
  setText(at.at, Number.isNaN(of.peakX) ? "\u2013" : `${lengthNumber(of.peakX)}, ${lengthNumber(of.peakY)}`);
  setText(at.x, lengthNumber(of.x));
  setText(at.y, lengthNumber(of.y));
}

/** @param {number} microseconds NaN where it is not known @returns {string} */
function time(microseconds) {
  if (Number.isNaN(microseconds)) return "\u2013";
  return microseconds < 1000 ? `${fixed(microseconds, 0)} µs` : `${number(microseconds / 1000)} ms`;
}
