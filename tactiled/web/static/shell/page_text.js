/** The page's texts: state, probe, range, playback and contacts. @module */

import { ContactTable } from "../maps/contact_table.js";
import { byId, setText } from "./dom.js";
import { LATE_MS } from "./frame_rate.js";
import { fixed, number, positionText } from "./format.js";
import { CONNECTING } from "./health.js";
import { PlaybackSession } from "../playback/playback_session.js";
import { Readings } from "./readings.js";
import { timeOffset } from "./timeline.js";
import { FORCE_UNITS, UNITS, lengthNumber, lengthText, pressureText, shearText } from "./units.js";
import { BAD, BELOW_ZERO, DEAD, FAULTY, MISSING, OUT_OF_RANGE, SATURATED, SHEAR } from "../wire/wire.js";

/** @import { DisplayRange } from "../maps/display_range.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Plane } from "../maps/geometry.js" */
/** @import { Health } from "./health.js" */
/** @import { Session } from "../wire/session.js" */
/** @import { Viewer } from "./viewer.js" */

const FLAG_NAMES = /** @type {const} */ ([[DEAD, "dead"], [BAD, "bad"], [MISSING, "missing"], [SATURATED, "saturated"], [OUT_OF_RANGE, "beyond the calibrated range"], [FAULTY, "faulty"], [BELOW_ZERO, "far below zero"]]);
const PILL_TEXTS = { live: "live", down: "bus down", connecting: "connecting", disconnected: "disconnected", silent: "silent", stale: "stale", ended: "end of recording", playback: "recording" };
const CURRENT_LEVELS = new Set(["live", "ended", "playback"]); // at which what is shown is what it should be
const HINTS = { flat: "Point at a map to read it, press to pin (rows, columns from 0).", surface: "Drag to turn, or use the arrow keys on a surface." };
/** @type {Health} */
const UNREACHABLE = { level: "disconnected", title: "DISCONNECTED", text: "The service does not answer. Retrying." };

export class PageText {
  constructor() {
    this.readings = new Readings();
    this.contacts = new ContactTable(byId("contact-list"));
    this._contactsOf = byId("contacts-of");
    this._level = "";
    this._along = ""; // axis in the section's texts, and whether it has a band
    this._autoRange = /** @type {HTMLInputElement} */ (byId("range-auto"));
    this._shear = byId("shear-choice");
    this._low = /** @type {HTMLInputElement} */ (byId("range-low"));
    this._high = /** @type {HTMLInputElement} */ (byId("range-high"));
    this._pressures = document.querySelectorAll("#main .pressure-unit");
    this._forces = document.querySelectorAll("#main .force-unit");
    this._pause = byId("pause");
    this._scrub = /** @type {HTMLInputElement} */ (byId("scrub"));
  }

  /** @returns {string} what the page says of the picture: live, stale, ... */
  get level() {
    return this._level;
  }

  /** Bring everything up to date. @param {Viewer} viewer @param {boolean} reachable the service answers */
  read(viewer, reachable) {
    const { session, pace } = viewer;
    const health = session?.health() ?? (reachable || viewer.name ? CONNECTING : UNREACHABLE);
    const paused = session?.paused ?? false;
    const replayed_s = session?.status?.position_s ?? null;
    const { frame } = viewer;
    this._restoration(session, frame);
    this._held(viewer.held.text);
    this._health(health, viewer.name, paused, session?.stream.link === "closed", replayed_s === null && pace.painted ? pace.latency : NaN);
    if (replayed_s !== null && health.level === "live" && !paused) setText(byId("pill-text"), `replay ${positionText(replayed_s)}`);
    document.body.classList.toggle("replayed", replayed_s !== null);
    this._shear.hidden = !session?.kinds.includes(SHEAR);
    const live = health.level === "live";
    this.readings.frame(frame);
    this.readings.status((session instanceof PlaybackSession ? session.status : session?.statusOfFrame) ?? null, live || health.level === "playback");
    this.readings.pace(pace.fps(), live && !paused && pace.painted && replayed_s === null ? pace.latency : NaN, pace.skew);
    setText(byId("probe"), probeText(viewer, frame) || HINTS[viewer.view.name === "surface" ? "surface" : "flat"]);
    if (!(session instanceof PlaybackSession)) this._playback(session, frame, live ? replayed_s === null ? "live" : "replay" : health.level === "ended" ? "end" : "last");
    this.range(viewer.range);
    this._units(session ? viewer.unit : -1);
    const { contactsOfFrame } = viewer;
    viewer.label(contactsOfFrame?.contacts ?? []);
    this.contacts.show(contactsOfFrame?.contacts ?? null, viewer.contacts, viewer.held.text, frame && session ? noContact(frame, session.plane) : "", viewer.unit, paused, viewer.charted);
    const offset = paused && contactsOfFrame && frame ? timeOffset(contactsOfFrame, frame) : "";
    setText(this._contactsOf, offset ? `from ${offset}` : "in the restored image");
    setText(byId("restored-sub"), viewer.held.text || (offset ? `contacts from ${offset}` : frame?.method === "raw" ? "not restored: as measured" : "pressure on the cover"));
    this._section(viewer);
  }

  /** @param {string} text what is shown; "" for one image */
  _held(text) {
    document.body.classList.toggle("held", text !== "");
    setText(byId("raw-sub"), text || "as the taxels measure");
    byId("hold-reset").hidden = !text.startsWith("highest");
  }

  /** Name the units of what is shown. @param {number} unit of pressure; -1 without a sensor */
  _units(unit) {
    for (const each of this._pressures) setText(each, UNITS[unit] ?? "");
    for (const each of this._forces) setText(each, FORCE_UNITS[unit] ?? "");
  }

  /** @param {Viewer} viewer */
  _section(viewer) {
    const { along } = viewer.marks;
    const { banded } = viewer.section;
    const drawn = `${along} ${banded}`;
    if (this._along === drawn) return;
    this._along = drawn;
    /** @type {HTMLElement} */ (document.querySelector(".key .band")).hidden = !banded;
    const turn = byId("section-turn");
    turn.textContent = along === "x" ? "\u2194" : "\u2195";
    turn.setAttribute("aria-label", `Cross-section along ${along}. Change`);
    const way = along === "x" ? "from left to right" : "from top to bottom";
    const what = `raw and restored${banded ? ", with a band of two standard deviations" : ""}`;
    byId("section").setAttribute("aria-label", `Pressure along ${along}, ${way}, ${what}`);
  }

  /** @param {Session|PlaybackSession|null} session @param {Frame|null} frame */
  _restoration(session, frame) {
    const status = session?.statusOfFrame ?? null;
    if (!session?.paused || !frame) this.readings.restoration(status?.ran ?? "", status, "", false);
    else if (!status) this.readings.restoration(frame.method, null, "details not reported", true);
    else {
      const offset = timeOffset(status, frame);
      this.readings.restoration(frame.method, status, offset && `details from ${offset}`, true);
    }
  }

  /** @param {Health} health @param {string} name @param {boolean} paused @param {boolean} closed @param {number} latency_ms NaN where the picture is not live */
  _health(health, name, paused, closed, latency_ms) {
    if (health.level !== this._level) {
      this._level = health.level;
      const state = (health.title || PILL_TEXTS[health.level]).toLowerCase();
      const what = health.level === "live" ? `${name} is live` : `${name || "service"}: ${state}. ${health.text}`;
      setText(byId("announce"), health.level === "connecting" ? "" : what);
      document.body.dataset.level = health.level;
    }
    document.body.classList.toggle("paused", paused);
    document.body.classList.toggle("old", !CURRENT_LEVELS.has(health.level));
    byId("banner").hidden = health.title === "" || health.level === "connecting";
    setText(byId("banner-title"), health.title);
    setText(byId("banner-text"), health.text);
    byId("banner-action").hidden = health.level !== "disconnected" || !closed;
    const warnings = Number(document.body.dataset.warnings);
    const isLate = health.level === "live" && !paused && latency_ms > LATE_MS;
    document.body.classList.toggle("late", isLate);
    const late = isLate ? `, ${fixed(latency_ms / 1000, 1)} s late` : "";
    const live = paused ? "paused" : `live${late}${warnings ? `, ${warnings} warning${warnings > 1 ? "s" : ""}` : ""}`;
    const text = health.level === "live" ? live : PILL_TEXTS[health.level];
    setText(byId("pill-text"), text);
    const title = name ? `${name}${health.level === "live" ? "" : ` (${text})`}, tactiled` : "tactiled";
    if (document.title !== title) document.title = title;
  }

  /** Announce what the pinned probe reads to a screen reader. @param {Viewer} viewer */
  announceProbe(viewer) {
    const read = viewer.probe.pinned ? probeText(viewer, viewer.frame) : "";
    setText(byId("announce-politely"), read || "Probe released.");
  }

  /**
   * @param {DisplayRange} range
   * @param {boolean} [typed] what somebody typed into its fields was taken or refused: they show the range too
   */
  range(range, typed = false) {
    this._autoRange.checked = range.auto;
    showNumber(this._low, range.low, typed);
    showNumber(this._high, range.high, typed);
  }

  /** @param {Session|null} session @param {Frame|null} frame @param {string} running what the newest frame is called */
  _playback(session, frame, running) {
    const count = session?.history.length ?? 0;
    const back = session?.back ?? 0;
    const paused = session?.paused ?? false;
    this._pause.setAttribute("aria-pressed", String(paused));
    setText(this._pause, paused ? "Go live" : "Pause");
    this._pause.title = `${paused ? "Go live" : "Pause"} (space)`;
    this._scrub.max = String(Math.max(0, count - 1));
    this._scrub.value = String(count - 1 - back);
    this._scrub.disabled = count < 2;
    const newest = session?.history.at(0);
    const when = frame && newest && back ? `${fixed(frame.timestamp - newest.timestamp, 2)} s` : "newest";
    const text = paused ? when : running;
    setText(byId("when"), text);
    if (this._scrub.getAttribute("aria-valuetext") !== text) this._scrub.setAttribute("aria-valuetext", text);
  }
}

/**
 * @param {Viewer} viewer
 * @param {Frame|null} frame
 * @returns {string} what the probe reads; "" where nothing is probed
 */
function probeText({ session, probe: { x, y }, view }, frame) {
  return frame && session && Number.isFinite(x) ? reading(session.plane, frame, x, y, view.name === "difference") : "";
}

/** @param {Frame} frame @param {Plane} plane @returns {string} what it means that no contact was found in it */
function noContact({ ofRaw, ofRestored }, { raw, restored }) {
  if (ofRaw.unknown >= raw.count) return "No taxel has data";
  if (ofRestored.unknown >= restored.felt) return "Nothing is known of contacts";
  if (ofRestored.unknown) return `No contact on the ${restored.felt - ofRestored.unknown} of ${restored.felt} cells that are known`;
  return ofRaw.unknown ? `No contact on the ${raw.count - ofRaw.unknown} of ${raw.count} taxels with data` : "No contact";
}

/**
 * @param {Plane} plane
 * @param {Frame} frame
 * @param {number} x mm
 * @param {number} y mm
 * @param {boolean} compared the difference is shown, too
 * @returns {string} what is there
 */
function reading(plane, frame, x, y, compared) {
  const r = plane.find(plane.raw, x, y);
  const s = plane.find(plane.restored, x, y);
  const place = `x ${lengthNumber(x)}, y ${lengthText(y)}`;
  if (r < 0 || s < 0) return `${place}: no taxel here`;
  const [raw, restored] = [frame.raw[r], frame.restored[s]].map((each) => (Number.isNaN(each) ? "unknown" : pressureText(each, frame.unit)));
  const off = frame.restored[s] - frame.raw[r];
  const difference = compared && !Number.isNaN(off) ? `, difference ${off >= 0.05 ? "+" : ""}${pressureText(off, frame.unit)}` : "";
  const flags = FLAG_NAMES.filter(([bit]) => frame.flags[r] & bit).map(([, name]) => `, ${name}`).join("");
  const taxel = plane.isGrid ? `taxel r${Math.floor(r / plane.raw.columns)} c${r % plane.raw.columns}` : `taxel ${r}`;
  const shears = [];
  if (frame.sheared && !Number.isNaN(frame.shear[r])) shears.push(fixed(frame.shear[r], 0), shearText(fixed(frame.shear[plane.raw.count + r], 0)));
  const dragged = frame.sheared && frame.traction.length && !Number.isNaN(frame.traction[s]);
  if (dragged) shears.push(number(frame.traction[s]), pressureText(frame.traction[plane.restored.count + s], 0));
  const shear = shears.length ? `, shear ${shears.join(", ")}` : "";
  return `${place}: raw ${raw}, restored ${restored}${difference}${shear} (${taxel}${flags})`;
}

/**
 * Show a number in a field, unless somebody is typing there.
 * @param {HTMLInputElement} input
 * @param {number} value
 * @param {boolean} typed it is shown even so
 */
function showNumber(input, value, typed) {
  if (!typed && document.activeElement === input) return;
  const text = String(+value.toPrecision(12));
  if (input.value !== text) input.value = text;
}
