/** The side panel's numbers and words. @module */

import { byId, setText } from "./dom.js";
import { fixed, newtons, number } from "./format.js";
import { measures } from "./measures.js";
import { Warnings } from "./warnings.js";

/** @import { Loss, Sensor } from "./api.js" */
/** @import { Frame } from "./frame_history.js" */
/** @import { Measures } from "./measures.js" */
/** @import { Status } from "./sensor_stream.js" */

/** What each method is called. */
const METHOD_TITLES = {
  auto: "Automatic", raw: "None, as measured", wiener: "Wiener filter", rl: "Richardson–Lucy",
  "rl-fast": "Richardson–Lucy, fast", nnls: "Non-negative (NNLS)",
  tv: "Non-negative, total variation", points: "A few points", idle: "idle",
};

/** What is counted, by unit. */
const LOSSES = /** @type {const} */ ({
  messages: [
    ["lost", "lost", "never came"],
    ["late", "late", "came out of order"],
    ["repeated", "repeated", "came twice"],
    ["malformed", "malformed", "the codec cannot mean them"],
    ["foreign", "foreign", "on the bus, but of no sensor"],
    ["dropped", "dropped", "thrown away by the kernel, not taken in time"],
  ],
  frames: [
    ["incomplete", "incomplete", "published with taxels missing"],
    ["skipped", "skipped", "not restored, because a newer one was there"],
  ],
  "on the bus": [
    ["errors", "error frames", "what the bus interface says went wrong on the wire"],
    ["bus_off", "bus-off", "times that the bus interface left the bus because of errors"],
    ["unsent", "unsent", "messages to skins that the bus did not take"],
    ["unreadable", "unreadable", "messages that the bus interface could not decode"],
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
    this._kinds = document.createElement("p");
    this._kinds.className = "sub";
    this._kinds.title = "What the error frames told";
    byId("loss").append(this._kinds);
    this._raw = measureCells("raw");
    this._restored = measureCells("restored");
    this._at = Object.fromEntries([
      "ran", "why", "iterations", "microseconds", "resolution", "noise", "noise-gain", "about", "sequence", "rate",
      "fps", "latency", "jitter", "skew",
    ].map((id) => [id, byId(id)]));
    this._warnings = byId("warnings");
    this._held = new Warnings();
    this._warned = "";
    this._of = byId("made-of");
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
    const heading = document.createElement("h4");
    heading.textContent = unit;
    const list = document.createElement("dl");
    list.className = "grid";
    for (const [kind, title, meaning] of kinds) {
      const name = document.createElement("dt");
      const value = document.createElement("dd");
      name.textContent = title;
      name.title = meaning;
      value.textContent = "\u2013";
      list.append(name, value);
      this._loss.set(kind, value);
    }
    return [heading, list];
  }

  /** @param {Sensor} sensor */
  about(sensor) {
    const told = Object.entries(sensor.error_kinds).filter(([, count]) => count);
    setText(this._kinds, told.map(([kind, count]) => `${kind.replaceAll("_", " ")} ${count}`).join(", "));
    const size = sensor.rows ? `${sensor.rows} × ${sensor.columns}` : `${sensor.taxels} taxels`;
    setText(this._at.about, `${size}, ${number(sensor.pitch_mm)} mm, ${sensor.bus}`);
    this._at.about.title = `${sensor.taxels} taxels at a pitch of ${number(sensor.pitch_mm)} mm, codec ${sensor.codec}, bus ${sensor.bus}`;
  }

  /** @param {Frame|null} frame */
  frame(frame) {
    const at = this._at;
    showMeasures(this._raw, frame ? frame.ofRaw : NO_MEASURES);
    showMeasures(this._restored, frame ? frame.ofRestored : NO_MEASURES);
    setText(at.iterations, frame ? String(frame.iterations) : "\u2013");
    setText(at.microseconds, frame ? time(frame.microseconds) : "\u2013");
    setText(at.resolution, frame ? `${fixed(frame.resolutionMm, 2)} mm` : "\u2013");
    setText(at.noise, frame ? `${number(frame.noiseKpa, 2)} kPa` : "\u2013");
    setText(at["noise-gain"], frame ? `× ${number(frame.noiseGain)}` : "\u2013");
    setText(at.sequence, frame ? String(frame.sequence) : "\u2013");
  }

  /** @param {Status|null} status @param {boolean} live what the status says still holds */
  status(status, live) {
    if (status && status === this._status && live === this._live) return;
    this._status = status;
    this._live = live;
    const at = this._at;
    setText(at.rate, status && live ? `${fixed(status.rate_hz, 1)} Hz` : "\u2013");
    setText(at.jitter, time((status?.jitter_s ?? NaN) * 1e6));
    setText(at.skew, time((status?.skew_s ?? NaN) * 1e6));
    for (const [kind, element] of this._loss) {
      const count = status ? status.loss[/** @type {keyof Loss} */ (kind)] : 0;
      setText(element, status ? String(count) : "\u2013");
      element.classList.toggle("some", count > 0 && !HARMLESS_LOSSES.has(kind));
    }
  }

  /**
   * How the image that is shown was made.
   * @param {string} ran the method; "" where it is not known
   * @param {Status|null} told of it, or of another image
   * @param {string} of which, where that is another
   * @param {boolean} still it does not change: no warning is held that was told of another
   */
  restoration(ran, told, of, still) {
    setText(this._at.ran, ran ? methodTitle(ran) : "\u2013");
    setText(this._at.why, told && told.ran === ran ? told.why : "");
    setText(this._of, of);
    if (still || told?.sensor !== this._status?.sensor) this._held.clear();
    const warnings = this._held.hold(told?.warnings ?? []);
    const joined = warnings.join("\n");
    if (joined === this._warned) return;
    this._warned = joined;
    this._warnings.replaceChildren(...warnings.map((each) => {
      const item = document.createElement("li");
      item.textContent = each;
      return item;
    }));
  }

  /**
   * @param {number} fps
   * @param {number} latencyMs NaN where the picture is not live
   * @param {number} skewS how far the two clocks are apart, s; 0 where they agree
   */
  pace(fps, latencyMs, skewS) {
    setText(this._at.fps, `${fixed(fps, 0)} fps`);
    setText(this._at.latency, Number.isFinite(latencyMs) ? `${fixed(latencyMs, 0)} ms` : "\u2013");
    this._at.latency.title = skewS
      ? `This browser's clock is ${fixed(skewS, 1)} s off the service's: the way over the network is left out` : "";
  }
}

/** @param {"raw"|"restored"} kind */
const measureCells = (kind) =>
  ({ force: byId(`force-${kind}`), peak: byId(`peak-${kind}`), x: byId(`x-${kind}`), y: byId(`y-${kind}`) });

/** @param {ReturnType<typeof measureCells>} at where it is told @param {Measures} of an image */
function showMeasures(at, of) {
  setText(at.force, newtons(of.force));
  setText(at.peak, fixed(of.peak, 1));
  setText(at.x, fixed(of.x, 1));
  setText(at.y, fixed(of.y, 1));
}

/** @param {number} microseconds NaN where it is not known @returns {string} */
function time(microseconds) {
  if (Number.isNaN(microseconds)) return "\u2013";
  return microseconds < 1000 ? `${fixed(microseconds, 0)} µs` : `${fixed(microseconds / 1000, 2)} ms`;
}
