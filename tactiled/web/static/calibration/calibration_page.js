/** The guided calibration: unload and tare, gain, cover. @module */

import * as api from "../wire/api.js";
import { CalibrationResult } from "./calibration_result.js";
import { DEMO, DEMO_UNLOADS, SIZES, tareText, taxelText, WAYS, zoneText } from "./calibration_text.js";
import { byId, element, setText } from "../shell/dom.js";
import { DisplayRange } from "../maps/display_range.js";
import { Heatmap } from "../maps/heatmap.js";
import { messageOf } from "../shell/notice.js";
import { tare, undoTare } from "./tare.js";
import { withToken } from "../wire/token_dialog.js";
import { UNITS, pressureText } from "../shell/units.js";

/** @import { CalibrationSession, Way } from "../wire/api.js" */
/** @import { Step } from "./calibration_text.js" */
/** @import { Viewer } from "../shell/viewer.js" */

const POLL_MS = 500; // between two looks at the session
const MAP_MS = 60; // between two paintings of the map
const MAP_PX = 300; // of its height, at most
const MAP_SHARE = 0.4; // of the window's height, at most
const PANELS = ["tare", "choose", "collect", "fitting", "result"];
const STEP_QUESTIONS = { tare: "", gain: "What presses the array?", cover: "What will you press with?" };

const dialog = /** @type {HTMLDialogElement} */ (byId("calibrate"));
const steps = /** @type {HTMLButtonElement[]} */ ([...dialog.querySelectorAll("[data-step]")]);
const size = /** @type {HTMLInputElement} */ (byId("calibrate-size-mm"));
const sizeLabel = byId("calibrate-size-label");
const sizeLine = byId("calibrate-size");
const value = /** @type {HTMLInputElement} */ (byId("calibrate-value"));
const apply = /** @type {HTMLButtonElement} */ (byId("calibrate-apply"));
const ends = /** @type {HTMLButtonElement[]} */ ([apply, ...dialog.querySelectorAll(".discard, #calibrate-again")]); // of a result
const fit = /** @type {HTMLButtonElement} */ (byId("calibrate-fit"));

export class CalibrationPage {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this._viewer = viewer;
    this._name = ""; // of the sensor that is calibrated
    this.isDemo = false;
    /** @type {Step} */
    this._step = "tare";
    /** @type {CalibrationSession|null} */
    this._session = null;
    this._panel = "";
    this._result = new CalibrationResult();
    this._heatmap = new Heatmap(/** @type {HTMLCanvasElement} */ (byId("calibrate-raw")), byId("calibrate-frame"));
    this._ranges = UNITS.map(() => new DisplayRange()); // by unit of pressure
    /** @type {import("../maps/geometry.js").Plane|null} */
    this._plane = null;
    /** @type {import("../wire/api.js").TaxelFault[]} */
    this._faults = [];
    /** @type {string|null} */
    this._verdict = null;
    this._busy = false; // with a look at the service
    /** @type {{name: string, before?: string, id?: string}|null} */
    this._applied = null; // the calibration that was, and its id once it is known: to undo it
    this._acting = false;
    this._acts = 0; // so far: what was asked before the newest is old
    this._error = ""; // of the last fit, as it was said
    this._unseen = false; // the last look failed
    this._isFirstLook = false; // since it was opened, and no step was chosen: it goes to that of a session that is there
    this._wire();
  }

  _wire() {
    const press = (/** @type {string} */ id, /** @type {() => unknown} */ action) => byId(id).addEventListener("click", action);
    for (const each of steps) each.addEventListener("click", () => this._go(/** @type {Step} */ (each.dataset.step)));
    press("calibrate-close", () => dialog.close());
    press("calibrate-next", () => this._go("gain"));
    press("calibrate-tare-now", () => tare(this._name, (text, bad = false) => this._say(text, bad)));
    press("calibrate-tare-undo", () => undoTare(this._name, (text, bad = false) => this._say(text, bad)));
    const startFit = () => this._act("Not fitted", () => api.calibrationAction(this._name, "fit"));
    for (const each of ["calibrate-fit", "calibrate-again"]) press(each, startFit);
    press("calibrate-cancel", () => this._act("Not cancelled", () => api.calibrationAction(this._name, "cancel")));
    press("calibrate-apply", () => this._apply());
    press("calibrate-undo", () => this._undo());
    for (const each of dialog.querySelectorAll(".discard")) each.addEventListener("click", () => this._discard());
    byId("calibrate-choose").addEventListener("submit", (event) => this._start(event));
    byId("calibrate-mark").addEventListener("submit", (event) => this._mark(event));
    byId("calibrate-ways").addEventListener("change", () => this._showSize());
    dialog.addEventListener("close", () => this._leave());
  }

  /** @param {boolean} offered whether the service calibrates */
  offer(offered) {
    byId("calibrate-open").hidden = !offered;
  }

  /** Open it for the sensor that is shown. */
  open() {
    if (byId("calibrate-open").hidden || !this._viewer.name || dialog.open) return;
    this._name = this._viewer.name;
    setText(byId("calibrate-title"), `Calibrate ${this._name}`);
    this._plane = null;
    this._session = null;
    this._error = "";
    this._say("");
    this._go("tare");
    this._isFirstLook = true;
    dialog.showModal();
    this._poll(); // another look may still be under way
    this._pollTimer = setInterval(() => this._poll(), POLL_MS);
    this._mapTimer = setInterval(() => this._paint(), MAP_MS);
  }

  _leave() {
    clearInterval(this._pollTimer);
    clearInterval(this._mapTimer);
  }

  /** Take the colours of the theme as it is now. */
  restyle() {
    this._result.restyle();
  }

  /** Look at what the service knows. */
  async _poll() {
    if (this._busy || this._acting) return;
    this._busy = true;
    const name = this._name;
    const acts = this._acts;
    try {
      const calibration = await api.calibration(name);
      if (this._step === "tare") ({ faults: this._faults, map: this._verdict } = await api.taxelHealth(name));
      if (acts !== this._acts) return; // what comes of it is the newest
      const session = calibration.session ? await api.calibrationSession(name) : null;
      if (acts !== this._acts || name !== this._name || !dialog.open) return;
      if (this._unseen) this._say("");
      this._unseen = false;
      const applied = this._applied?.name === name ? this._applied : null;
      if (applied && (applied.id ??= calibration.id) !== calibration.id) this._applied = null; // another was applied since
      this._showTare(calibration);
      this._take(session);
      if (this._isFirstLook) {
        if (session) this._go(WAYS[session.way].step);
        this._isFirstLook = false;
        this._focus();
      }
    } catch (error) {
      this._unseen = true;
      this._say(messageOf(error), true);
    } finally {
      this._busy = false;
    }
  }

  /** @param {CalibrationSession|null} session */
  _take(session) {
    if (this._session && !session) this._say("The calibration has ended.");
    this._session = session;
    this._show();
  }

  /** @param {Step} step */
  _go(step) {
    this._isFirstLook = false;
    this._step = step;
    const ways = /** @type {Way[]} */ (Object.keys(WAYS)).filter((each) => WAYS[each].step === step);
    if (this.isDemo) setText(byId("calibrate-unload"), DEMO_UNLOADS);
    setText(byId("calibrate-question"), STEP_QUESTIONS[step]);
    byId("calibrate-ways").replaceChildren(...ways.map((each, i) => choice(each, this.isDemo ? DEMO[each] : WAYS[each].hint, i === 0)));
    this._showSize();
    this._show();
  }

  /** @returns {CalibrationSession|null} the one that belongs to the step that is shown */
  get _own() {
    return this._session && WAYS[this._session.way].step === this._step ? this._session : null;
  }

  _show() {
    const own = this._own;
    const ofState = { collecting: "collect", fitting: "fitting", fitted: "result", ended: "choose" };
    const panel = this._step === "tare" ? "tare" : own ? ofState[own.state] : "choose";
    for (const each of PANELS) byId(`calibrate-${each}`).hidden = each !== panel;
    for (const each of steps) {
      if (each.dataset.step === this._step) each.setAttribute("aria-current", "step");
      else each.removeAttribute("aria-current");
    }
    if (own) this._showSession(own);
    byId("calibrate-undo").hidden = Boolean(this._session) || this._applied?.name !== this._name;
    const zones = own && panel !== "result" ? own.quality : null;
    this._showZones(zones?.zones ?? [], zones?.zone_presses_needed ?? 0);
    if (panel !== this._panel) {
      this._panel = panel;
      const focused = document.activeElement;
      if (dialog.open && !(focused && dialog.contains(focused) && focused.checkVisibility())) this._focus();
    }
  }

  /** Let the focus stand where the work goes on. */
  _focus() {
    const places = byId(`calibrate-${this._panel}`).querySelectorAll("input:checked, input[type=number], button");
    const all = /** @type {HTMLElement[]} */ ([...places]).filter((each) => each.checkVisibility() && each.matches(":enabled"));
    const next = all.find((each) => each.matches("input, .main")) ?? all.find((each) => !each.matches(".discard"));
    (next ?? byId("calibrate")).focus(); // of the dialog, nothing is pressed by Enter
  }

  /** @param {import("../wire/api.js").Calibration} calibration */
  _showTare({ load, tared_at: tared, can_undo: undo, kpa_per_count: gain, dead }) {
    setText(byId("calibrate-load"), load || "none");
    byId("calibrate-load").classList.toggle("some", Boolean(load));
    setText(byId("calibrate-tared"), tareText(tared ? Math.max(0, Date.now() / 1000 - tared) : null));
    byId("calibrate-tare-undo").hidden = !undo;
    setText(byId("calibrate-gain-now"), gain === null ? "unknown: counts are shown" : `${Number(gain.toPrecision(3))} kPa per count`);
    setText(byId("calibrate-taxels"), taxelText(dead, this._faults, this._verdict));
    byId("calibrate-taxels").classList.toggle("some", this._faults.length > 0 || !["as configured", null].includes(this._verdict));
  }

  /** @param {CalibrationSession} session */
  _showSession(session) {
    const { quality, state } = session;
    const way = WAYS[session.way];
    setText(byId("calibrate-do"), this.isDemo ? DEMO[session.way] : way.instruction);
    setText(byId("calibrate-advice"), quality.advice);
    byId("calibrate-advice").classList.toggle("good", quality.enough);
    progress("calibrate-presses", quality.presses_needed ? quality.presses / quality.presses_needed : 0);
    byId("calibrate-mark").hidden = way.mark === null;
    setText(byId("calibrate-unit"), way.unit);
    setText(byId("calibrate-load-now"), session.load || "none");
    byId("calibrate-of-presses").hidden = way.step === "gain" || session.way === "blind";
    const last = byId("calibrate-last");
    setText(last, quality.last_unused ? `not used: ${quality.last_unused}` : quality.presses ? "used" : "none yet");
    last.classList.toggle("some", Boolean(quality.last_unused));
    const saturated = byId("calibrate-saturated");
    setText(saturated, quality.presses_saturated ? `${quality.presses_saturated}, not used` : "none");
    saturated.classList.toggle("some", quality.presses_saturated > 0);
    setText(byId("calibrate-frames"), `${Math.round(session.seconds)} of ${session.seconds_limit} s${session.full ? ", full: fit or discard" : ""}`);
    fit.disabled = quality.presses === 0;
    if (session.error && session.error !== this._error) this._say(session.error, true);
    this._error = session.error;
    if (state === "fitted") this._result.show(session);
  }

  /** @param {number[][]} zones presses in each @param {number} needed */
  _showZones(zones, needed) {
    const list = byId("calibrate-zones");
    list.hidden = !zones.length;
    const cells = zones.flat();
    if (list.children.length !== cells.length) list.replaceChildren(...cells.map(() => element("li", "")));
    cells.forEach((presses, i) => {
      const { text, done } = zoneText(presses, needed);
      setText(list.children[i], text);
      list.children[i].classList.toggle("done", done);
    });
  }

  /** Ask for the size of what presses, where it has one. */
  _showSize() {
    const asked = sizeOf(this._way);
    sizeLine.hidden = !asked;
    if (!asked) return;
    setText(sizeLabel, asked.label);
    setText(/** @type {Element} */ (sizeLine.lastElementChild), asked.empty);
    dialog.querySelector("#calibrate-ways label:has(:checked)")?.after(sizeLine);
  }

  /** @returns {Way} that is chosen */
  get _way() {
    const checked = /** @type {HTMLInputElement|null} */ (dialog.querySelector("#calibrate-ways input:checked"));
    return /** @type {Way} */ (checked?.value ?? "tip");
  }

  /** @param {string} text @param {boolean} [bad] */
  _say(text, bad = false) {
    const line = byId("calibrate-message");
    setText(line, text);
    line.classList.toggle("bad", bad);
  }

  /**
   * Do something, then look at what came of it.
   * @param {string} failed what to say where it fails
   * @param {() => Promise<CalibrationSession|null>} action
   * @returns {Promise<boolean>}
   */
  async _act(failed, action) {
    this._say("");
    /** @type {CalibrationSession|null} */
    let session = null;
    this._acting = true;
    this._acts += 1;
    const done = await withToken(async () => { session = await action(); }, failed, (text, bad) => this._say(text, bad));
    this._acting = false;
    if (done) {
      this._session = session;
      this._show();
    }
    return done;
  }

  /** @param {Event} event */
  _start(event) {
    event.preventDefault();
    const open = this._session;
    if (open) this._say(`A calibration by ${WAYS[open.way].title.toLowerCase()} is open: finish or discard it first.`, true);
    else {
      const asked = sizeOf(this._way);
      const given = asked && Number.isFinite(size.valueAsNumber) ? { [asked.key]: size.valueAsNumber } : {};
      this._act("Not started", () => api.startCalibration(this._name, { way: this._way, ...given }));
    }
  }

  /** @param {Event} event */
  async _mark(event) {
    event.preventDefault();
    const own = this._own;
    const key = own && WAYS[own.way].mark;
    const load = value.valueAsNumber;
    if (!key || !Number.isFinite(load)) return;
    if (await this._act("Not taken", () => api.markLoad(this._name, { [key]: load }))) {
      this._say(`Taken: ${load} ${byId("calibrate-unit").textContent}.`);
      value.select();
    }
  }

  async _apply() {
    const step = this._step;
    const setDisabled = (/** @type {boolean} */ is) => ends.forEach((each) => { each.disabled = is; });
    setDisabled(true);
    const name = this._name;
    const done = await this._act("Not applied", async () => {
      if (step === "cover") this._say("The cover is being solved: this takes some seconds.");
      const { id: before } = await api.calibration(name);
      const ended = await api.calibrationAction(name, "apply");
      this._applied = { name, before };
      setText(byId("calibrate-undo"), `Undo the ${step}`);
      return ended;
    });
    setDisabled(false);
    if (!done) return;
    if (step === "gain") this._go("cover");
    this._say(step === "gain" ? "The gain is applied. Next: the cover." : "The cover is applied: images are restored with it.");
    this._viewer.loadKernel();
  }

  async _undo() {
    const { name, before } = /** @type {{name: string, before?: string}} */ (this._applied);
    const undo = /** @type {HTMLButtonElement} */ (byId("calibrate-undo"));
    undo.disabled = true;
    const done = await this._act("Not undone", async () => {
      const { files } = await api.formerCalibrations(name);
      const former = files.find(({ id }) => id === before);
      if (!former) throw new Error("the calibration before is no longer kept");
      await api.applyFormer(name, former.number);
      this._applied = null;
      return this._session;
    });
    undo.disabled = false;
    if (!done) return;
    this._say("Undone: the calibration before holds again.");
    this._focus();
    this._viewer.loadKernel();
  }

  async _discard() {
    if (await this._act("Not discarded", () => api.discardCalibration(this._name))) this._say("Discarded: nothing was changed.");
  }

  /** Paint the newest raw image. */
  _paint() {
    const { session, view: { colormap } } = this._viewer;
    if (!session?.frame || !colormap || this._viewer.name !== this._name) return;
    if (this._plane !== session.plane) {
      this._plane = session.plane;
      this._heatmap.use(session.plane, session.plane.raw);
      const tall = Math.min(MAP_PX, MAP_SHARE * window.innerHeight);
      this._heatmap.resize(Math.min(byId("calibrate-map").clientWidth / session.plane.width, tall / session.plane.height));
      for (const each of this._ranges) each.reset();
    }
    const { ofRaw, raw, unit, noise, timestamp } = session.frame;
    this._ranges[unit].follow(ofRaw.highest || 0, noise || 0, timestamp);
    this._heatmap.paint(raw, this._ranges[unit], colormap);
    setText(byId("calibrate-peak"), `peak ${pressureText(ofRaw.peak, unit)}`);
  }
}

/** @param {Way} way @returns {typeof SIZES.tip|null} what is measured of what presses */
const sizeOf = (way) => (way === "tip" || way === "edge" ? SIZES[way] : null);

/** @param {string} id @param {number} share */
function progress(id, share) {
  /** @type {HTMLProgressElement} */ (byId(id)).value = Math.min(1, share);
}

/** @param {Way} way @param {string} hint @param {boolean} checked @returns {HTMLElement} */
function choice(way, hint, checked) {
  const radio = element("input", "");
  radio.type = "radio";
  radio.name = "way";
  radio.value = way;
  radio.checked = checked;
  return element("label", "", radio, element("span", "", element("b", "", WAYS[way].title), element("span", "sub", hint)));
}
