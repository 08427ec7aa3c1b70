/** A recording on the page: opened from the list, by the address or as a dropped file; its controls and its force. @module */

import * as api from "../wire/api.js";
import { Chart, PLOT_LEFT_PX, PLOT_RIGHT_PX, line } from "../charts/chart.js";
import { roundUp } from "../maps/display_range.js";
import { byId, setText } from "../shell/dom.js";
import { dateText, positionText } from "../shell/format.js";
import { isBrowsers } from "../shell/keyboard.js";
import { messageOf, notice } from "../shell/notice.js";
import { SPEEDS, recordingName } from "./playback_clock.js";
import { PlaybackSession } from "./playback_session.js";
import { RecordedSeriesPanel } from "./recorded_series.js";
import { withToken } from "../wire/token_dialog.js";
import { FORCE_UNITS } from "../shell/units.js";

/** @import { Played } from "../wire/api.js" */
/** @import { AxisWindow } from "../charts/chart_window.js" */
/** @import { Curve } from "./recorded_series.js" */
/** @import { Session } from "../wire/session.js" */
/** @import { Viewer } from "../shell/viewer.js" */

const FIRST_MS = 200; // between two looks whether the first frames were read
const READ_MS = 1000; // between two looks how far the file was read
const MAX_TIMES = 20; // that a chart's description names
const NO_FRAMES = "no frame of this sensor";

/** @param {Session|PlaybackSession|null|undefined} session @returns {PlaybackSession|null} */
const playbackOf = (session) => (session instanceof PlaybackSession ? session : null);

export class PlaybackPage {
  /** @param {Viewer} viewer @param {() => Promise<void>} listRecordings look at the folder again */
  constructor(viewer, listRecordings) {
    this._viewer = viewer;
    this._listRecordings = listRecordings;
    const given = new URLSearchParams(location.hash.split("?")[1] ?? "");
    /** Name of the recording that is open; "" for none. */
    this.recording = given.get("recording") ?? "";
    this._series = new RecordedSeriesPanel((number) => {
      viewer.show(viewer.session instanceof PlaybackSession ? viewer.session.recorded.frames - 1 - number : 0);
      window.scrollTo({ top: 0 });
    });
    /** @type {Curve|null} that the chart was last asked to draw */
    this._curve = null;
    this._position = Number(given.get("at") ?? 0) || 0;
    this._speed = /** @type {HTMLSelectElement} */ (byId("speed"));
    this._loop = /** @type {HTMLInputElement} */ (byId("loop"));
    this._pause = byId("pause");
    this._scrub = /** @type {HTMLInputElement} */ (byId("scrub"));
    this._speed.replaceChildren(...SPEEDS.map((each) => new Option(`${each}×`, String(each), each === 1, each === 1)));
    this._speed.addEventListener("change", () => this._session?.setSpeed(Number(this._speed.value)));
    this._loop.addEventListener("change", () => this._setLoop());
    byId("recorded-close").addEventListener("click", () => this.close());
    const file = /** @type {HTMLInputElement} */ (byId("recording-file"));
    file.addEventListener("change", () => {
      if (file.files?.length) this.add(file.files[0]);
      file.value = "";
    });
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      if (event.dataTransfer?.files.length) this.add(event.dataTransfer.files[0]);
    });
    document.addEventListener("keydown", (event) => this._jump(event));
    byId("forces").addEventListener("click", (event) => this._seekInChart(event));
    viewer.source = this.recording ? (name) => this._load(name) : null;
  }

  /** @returns {PlaybackSession|null} */
  get _session() {
    return playbackOf(this._viewer.session);
  }

  /** Play a recording as the sensor that is watched. @param {string} name */
  open(name) {
    if (!this._viewer.name) {
      notice("To play a recording, choose one sensor.", true);
      return;
    }
    this.recording = name;
    this._position = 0;
    this._viewer.source = (sensor) => this._load(sensor);
    this._viewer.reopen(this._viewer.name);
    showMaps();
  }

  /** Watch the sensors live again. */
  close() {
    if (!this.recording) return;
    this.recording = "";
    this._viewer.source = null;
    if (this._viewer.name) this._viewer.reopen(this._viewer.name);
  }

  /** @param {string} what cannot be done to a recording @returns {boolean} one is open, and the page says so */
  refuses(what) {
    if (this.recording) notice(`A recording plays: go back to live to ${what}.`, true);
    return this.recording !== "";
  }

  /** Upload a file and play it. @param {File} file */
  async add(file) {
    const name = recordingName(file.name);
    notice(`Uploading ${name} …`);
    if (!await withToken(() => api.uploadRecording(name, file), "Not added")) return;
    notice(`Added: ${name}.`);
    await this._listRecordings().catch(() => undefined);
    this.open(name);
  }

  /** Add what plays, and where, to the address. @param {URLSearchParams} query */
  addTo(query) {
    if (!this.recording) return;
    query.set("recording", this.recording);
    if (this._session?.paused) this._position = this._session.position;
    if (this._position) query.set("at", String(+this._position.toFixed(3)));
  }

  /** @param {number} steps along the speeds */
  changeSpeed(steps) {
    if (!this._session) return;
    this._speed.selectedIndex = Math.max(0, Math.min(SPEEDS.length - 1, this._speed.selectedIndex + steps));
    this._session.setSpeed(Number(this._speed.value));
  }

  /** Go to the first frame or the last, unless the key is for a field. @param {KeyboardEvent} event */
  _jump(event) {
    const elsewhere = isBrowsers(event) || (event.target instanceof Element && event.target.closest("input, select, dialog"));
    if (!this._session || elsewhere || (event.key !== "Home" && event.key !== "End")) return;
    event.preventDefault();
    this._session.show(event.key === "End" ? 0 : Infinity);
  }

  /**
   * Wait for a recording's first frames.
   * @param {string} sensor
   * @returns {Promise<Played|null>} null where there is nothing to play: the page says why, and goes on live
   */
  async _load(sensor) {
    const name = this.recording;
    try {
      let recorded = await api.played(name, sensor);
      if (recorded.reading) notice(`Reading ${name} …`);
      for (; !recorded.frames && recorded.reading; recorded = await api.played(name, sensor)) await sleep(FIRST_MS);
      if (!recorded.frames) throw new Error(recorded.error ?? NO_FRAMES);
      return recorded;
    } catch (error) {
      notice(`${name}: ${messageOf(error)}`, true);
      if (this.recording === name) {
        this.recording = "";
        this._viewer.source = null;
      }
      return null;
    }
  }

  /** Tell a session more as its file is read. @param {PlaybackSession} session */
  async _follow(session) {
    while (session.recorded.reading) {
      await sleep(READ_MS);
      if (this._session !== session) return;
      const now = await api.played(session.recorded.name, session.name).catch(() => session.recorded);
      session.update(now);
      if (!now.reading && now.error) notice(`${now.name}: ${now.error}`, true);
    }
  }

  /** A session has begun. @param {PlaybackSession} session */
  begin(session) {
    session.loop = this._loop.checked;
    session.setSpeed(Number(this._speed.value));
    session.showAt(this._position);
    this._viewer.position.reset();
    this._chart = new OverviewChart(this._viewer.forces.chart, this._viewer.position);
    this._series.use(session);
    this._follow(session);
  }

  _setLoop() {
    if (this._session) this._session.loop = this._loop.checked;
  }

  /** @param {MouseEvent} event on the chart of the force */
  _seekInChart(event) {
    const session = this._session;
    const width = byId("forces").clientWidth - PLOT_LEFT_PX - PLOT_RIGHT_PX;
    const { left, right } = this._viewer.position;
    session?.showAt(left + ((event.offsetX - PLOT_LEFT_PX) / width) * (right - left));
  }

  /** Bring texts and controls up to date. */
  read() {
    const session = this._session;
    document.body.classList.toggle("playback", this.recording !== "");
    byId("recorded").hidden = this.recording === "";
    setText(byId("recorded-name"), this.recording);
    setText(byId("recorded-text"), session ? describe(session.recorded) : "reading …");
    /** @type {HTMLButtonElement} */ (byId("series-measure")).disabled = !session;
    const curve = session && this._series.curve;
    if (curve !== this._curve) this._viewer.refresh();
    this._curve = curve;
    setText(byId("force-name"), curve ? "Whole recording" : "Total force");
    setText(byId("force-span"), curve ? "restored" : session ? "whole recording" : this._viewer.time.text);
    const above = curve?.above.length ? `, above the threshold from ${curve.above.slice(0, MAX_TIMES).map((i) => positionText(curve.x[i])).join(", ")}` : "";
    byId("forces").setAttribute("aria-label", session ? `${curve ? curve.title : "Total raw force"} over the whole recording${above}` : `Total force, raw and restored, ${this._viewer.time.text}`);
    document.body.classList.toggle("curve", Boolean(curve));
    byId("force-above").hidden = !above;
    setText(byId("loss-since"), session ? "since its beginning" : "since the service started");
    this._scrub.setAttribute("aria-label", session ? "Position in the recording" : "Kept frames, newest at the right");
    this._viewer.regions?.read();
    if (!session) return;
    this._series.read(this._viewer.regions?.shapes ?? "", this._viewer.regions?.thresholds ?? {});
    const { recorded, position, paused } = session;
    setText(this._pause, paused ? "Play" : "Pause");
    this._pause.title = `${paused ? "Play" : "Pause"} (space)`;
    const where = `${positionText(position)} / ${positionText(recorded.duration_s)}`;
    setText(byId("when"), where);
    this._scrub.max = String(recorded.frames - 1);
    this._scrub.value = String(session.number);
    this._scrub.disabled = recorded.frames < 2;
    this._scrub.setAttribute("aria-valuetext", where);
  }

  /** Draw the force over the whole recording. @param {number} unit of pressure */
  draw(unit) {
    if (this._session) this._chart?.draw(this._session, unit, this._series.curve);
  }
}

/** Force over a whole recording, and where it is. */
class OverviewChart {
  /** @param {Chart} chart @param {AxisWindow} part of the recording that is shown */
  constructor(chart, part) {
    this._chart = chart;
    this._part = part;
    this._lines = [line(0, "raw")];
    /** @type {Played|Curve|null} */
    this._of = null;
    this._axes = { left: 0, right: 1, bottom: 0, top: 1, x: "position, s", y: "" };
  }

  /** @param {PlaybackSession} session @param {number} unit of pressure @param {Curve|null} curve instead of the raw force */
  draw({ recorded, position }, unit, curve) {
    if (this._of !== (curve ?? recorded)) {
      this._of = curve ?? recorded;
      const { x: at, y: values, unit: axis } = curve ?? { x: recorded.positions_s, y: recorded.force, unit: FORCE_UNITS[unit] };
      const all = Float64Array.from(values, (each) => each ?? NaN);
      const known = all.filter(Number.isFinite);
      const above = curve?.above ?? [];
      const [x, y] = [at, all].map((each) => Float64Array.from(above, (i) => each[i]));
      this._lines = [
        { ...line(0, curve ? "restored" : "raw"), x: Float64Array.from(at), y: all, length: at.length },
        { ...line(0, "raw", "points"), x, y, length: above.length },
      ];
      const top = roundUp(Math.max(1e-3, ...known));
      const lowest = Math.min(0, ...known);
      const bottom = lowest < -0.05 * top ? -roundUp(-lowest) : -0.06 * top;
      this._axes = { ...this._axes, top, bottom, y: axis };
    }
    this._part.limit(0, Math.max(recorded.duration_s, 1e-3));
    this._axes.left = this._part.left;
    this._axes.right = this._part.right;
    this._chart.draw(this._axes, this._lines, position);
  }
}

/** @param {Played} recorded @returns {string} */
function describe({ frames, reading, timestamp, tared_at, calibration, error, caveats }) {
  const when = (/** @type {number} */ s) => dateText(s, "medium");
  const zero = tared_at === null ? "" : `, tared ${when(tared_at)}`;
  const file = calibration === "configured" ? "" : `, calibration ${calibration}`;
  const end = reading ? ", reading …" : error ? `, ends early: ${error}` : "";
  const also = caveats.map((each) => `, ${each}`).join("");
  return `${timestamp === null ? "" : `${when(timestamp)}, `}${frames} ${frames === 1 ? "frame" : "frames"}${zero}${file}${also}${end}`;
}

/** Bring the maps into view, for what is shown on them from now on. */
function showMaps() {
  byId("maps").focus({ preventScroll: true });
  window.scrollTo({ top: 0 });
}

/** @param {number} ms @returns {Promise<void>} */
const sleep = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });
