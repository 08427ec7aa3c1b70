/** The sensor that is watched, on the screen: maps, charts and the cover. @module */

import * as api from "../wire/api.js";
import { AxisWindow, TimeWindow } from "../charts/chart_window.js";
import { zoomable } from "../charts/chart_zoom.js";
import { ContactOutline } from "../maps/contact_outline.js";
import { MAX_ROWS } from "../maps/contact_table.js";
import { CrossSection, placeLine } from "../charts/cross_section.js";
import { DisplayRange } from "../maps/display_range.js";
import { byId } from "./dom.js";
import { FrameRate } from "./frame_rate.js";
import { Plane } from "../maps/geometry.js";
import { HeldImage } from "../maps/held_image.js";
import { KernelPanel } from "../charts/kernel.js";
import { Maps } from "../maps/maps.js";
import { notice, messageOf } from "./notice.js";
import { PlaybackSession } from "../playback/playback_session.js";
import { Probe } from "../maps/probe.js";
import { Session } from "../wire/session.js";
import { TrendChart } from "../charts/trend_chart.js";
import { FORCE_SCALES, FORCE_UNITS, UNITS, forceText, unitOf } from "./units.js";
import { View } from "./view.js";
import { kindsOf } from "../wire/wire.js";

/** @import { Played, Sensor } from "../wire/api.js" */
/** @import { Colormap } from "../maps/colormap.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Axis } from "../maps/geometry.js" */
/** @import { Marks } from "../maps/overlay.js" */
/** @import { Contact, ContactsMessage, Status } from "../wire/sensor_stream.js" */

const MIN_FORCES = FORCE_SCALES.map((each) => 100 * each); // that the chart of forces reaches up to: 0.1 N
/** @type {[number, number]} s, of the chart of latencies */
const LATENCY_ENDS = [-10, 0];
const TREND_MS = 100; // between two drawings of what changes slowly

/**
 * @typedef {object} Listener
 * @property {() => void} onChange something shown as text has changed
 * @property {() => void} onProbe somebody has pinned the probe, moved it by keys, or released it
 * @property {(status: Status) => void} onStatus
 * @property {(session: PlaybackSession) => void} onPlayback a recording is watched from now on
 */

export class Viewer {
  /** @param {Listener} listener */
  constructor(listener) {
    this._listener = listener;
    /** By unit of pressure. */
    this.ranges = UNITS.map(() => new DisplayRange());
    this.maps = new Maps(() => this.refresh());
    /** The time axis of live charts. */
    this.time = new TimeWindow(() => {
      this._redraw();
      this.onTime();
    });
    /** The parts of a recording, and of the cross-section, that are shown. */
    this.position = new AxisWindow(() => this._redraw());
    this.along = new AxisWindow(() => this._redraw());
    this.section = new CrossSection(byId("section"), this.along);
    this.forces = new TrendChart(byId("forces"), FORCE_UNITS[0], MIN_FORCES[0]);
    this.latencies = new TrendChart(byId("latencies"), "ms", 5);
    zoomable(byId("section"), () => this.along);
    zoomable(byId("forces"), () => (this.session instanceof PlaybackSession ? this.position : this.time));
    this.kernel = new KernelPanel(byId("kernel"));
    this.pace = new FrameRate();
    /** Whether the newest image is shown, or what it had for some time. */
    this.held = new HeldImage();
    /** Whether the way of the centre of pressure is shown. */
    this.path = false;
    this.probe = new Probe([this.maps.raw, this.maps.restored, this.maps.difference], (deliberate) => {
      this.refresh();
      if (deliberate) listener.onProbe();
    });
    this.view = new View(this.ranges, this.maps.projection, () => this.restyle());
    /** @type {import("../maps/regions.js").Regions|null} */
    this.regions = null;
    /** @type {Map<string, number>|null} what the chart of series shows, as "contact 3"; null where it can show none */
    this.charted = null;
    /** @type {Session|PlaybackSession|null} */
    this.session = null;
    /** @type {((name: string) => Promise<Played|null>)|null} gives the recording to watch in the place of a sensor */
    this.source = null;
    /** Learns that something was painted. @type {(now: number) => void} */
    this.onPainted = () => {};
    /** Draws other charts of the time axis. @type {() => void} */
    this.onTime = () => {};
    /** Learns that the charts were drawn that go on with the time. @type {() => void} */
    this.onTrends = () => {};
    /** Draws force over a recording. @type {(unit: number) => void} */
    this.drawOverview = () => {};
    /** Name of the sensor that is chosen; "" for none. */
    this.name = "";
    /** Whether contacts are shown. */
    this.contacts = true;
    /** Whether shear is shown, if the skin measures it. */
    this.shear = true;
    /** Whether anybody can see the cross-section. */
    this.sectionSeen = true;
    /** @type {Marks} */
    this.marks = { along: "x", lineAt: NaN, probeX: NaN, probeY: NaN, pinned: false, contacts: null, centred: false, labels: new Map(), slots: null, outline: new ContactOutline(), outlined: -1, names: [] };
    this._selection = 0; // counts up, so that an answer for a sensor left meanwhile is dropped
    this._fresh = false; // a frame came that is not painted yet
    this._dirty = false;
    this._trendsAt = 0;
    /** @type {Contact[]|null} in the frame that is marked */
    this._found = null;
    this._paint = this._paint.bind(this);
  }

  /** Draw the charts at once. */
  _redraw() {
    this._trendsAt = 0;
    this.refresh();
  }

  /** @returns {number} unit of pressure of the sensor that is watched, index in UNITS */
  get unit() {
    return this.session?.unit ?? 0;
  }

  /** @returns {DisplayRange} of the sensor that is watched */
  get range() {
    return this.ranges[this.unit];
  }

  /** @returns {Frame|null} what is shown: a frame, or what was held of some */
  get frame() {
    const { session } = this;
    if (!session) return null;
    return this.held.of(session.frame, session.history, placeOf(session), session.plane, session.paused);
  }

  /** Show images as they come, or what is held of them. @param {import("../maps/held_image.js").Held} kind */
  hold(kind) {
    const { session } = this;
    this.held.reset(kind);
    if (session?.frame) this.held.push(session.frame, session.plane);
    this._fit();
    this.refresh();
    this._listener.onChange();
  }

  /** Paint at the screen's next turn. */
  refresh() {
    if (this._dirty) return;
    this._dirty = true;
    requestAnimationFrame(this._paint);
  }

  /** @returns {ContactsMessage|null} contacts to show: of the frame that is shown, or of one near it */
  get contactsOfFrame() {
    const frame = this.session?.frame;
    return this.session && frame && this.contacts && this.held.kind === "now" ? this.session.contacts.at(frame.timestamp) : null;
  }

  /** Label contacts on the maps with the forces that the table has. @param {Contact[]} contacts in the table */
  label(contacts) {
    const labels = new Map(contacts.map((each) => [each.id, this._labelOf(each)]));
    const { marks } = this;
    if (labels.size === marks.labels.size && [...labels].every(([id, text]) => marks.labels.get(id) === text)) return;
    marks.labels = labels;
    this.refresh();
  }

  /** @param {Contact} contact @returns {string} */
  _labelOf({ id, force, cut_off }) {
    return `${id}: ${cut_off ? "≥ " : ""}${forceText(force, this.unit)}`;
  }

  /** @param {number} now ms */
  _paint(now) {
    this._dirty = false;
    const { session, view: { colormap } } = this;
    if (!session || !colormap) return;
    if (this._fresh && session.holdBack()) this._fresh = false;
    const { frame } = this;
    this.maps.colorbar.draw(this.range, colormap, this.unit);
    if (frame) this._mark(frame, session);
    if (frame) this.maps.paint(frame, this.range, colormap, this.marks, this.shear, this.view);
    this._drawPath(session);
    this.section.draw(frame, this.marks, this.range, frame && this._deviation(frame, session, now), this.unit);
    if (!this._fresh || now - this._trendsAt >= TREND_MS) {
      this._trendsAt = now;
      this.forces.measure(FORCE_UNITS[this.unit], MIN_FORCES[this.unit]);
      if (session instanceof PlaybackSession) this.drawOverview(this.unit);
      else {
        const cursor = session.back ? session.history.at(session.back)?.timestamp ?? NaN : NaN;
        const { trace } = session.history;
        this.forces.draw(trace, this.time.ends(trace.times[trace.place(0)]), cursor);
        this.latencies.draw(session.history, LATENCY_ENDS, cursor);
        this.onTrends();
      }
    }
    this.onPainted(now);
    const { frame: newest } = session;
    if (!this._fresh || !newest) return;
    this._fresh = false;
    this.pace.paint(now, newest, session.freshness.minDelay);
    session.history.latencies[newest.place] = this.pace.latency;
    document.documentElement.dataset.painted = String(this.pace.painted);
    session.painted();
  }

  /** Write what is read of the difference that is shown. */
  write() {
    if (this.frame) this.maps.write(this.frame, this.view);
  }

  /** Paint at once what is shown, for a picture of it. */
  paintNow() {
    this._paint(performance.now());
    this.write();
  }

  /** Paint the maps alone as they are now, at another number of pixels. @param {Frame} frame @param {Colormap} colormap */
  paintMaps(frame, colormap) {
    this.maps.layout();
    this.regions?.layout(this.maps.zoom);
    this.maps.paint(frame, this.range, colormap, this.marks, this.shear, this.view);
    if (this.session) this._drawPath(this.session);
  }

  /** @param {Session|PlaybackSession} session */
  _drawPath(session) {
    this.maps.drawPath(this.path ? session.history : null, placeOf(session), session.plane);
  }

  /** @param {Frame} frame @param {Session|PlaybackSession} session */
  _mark(frame, session) {
    const { marks, probe } = this;
    marks.lineAt = placeLine(session.plane, marks, probe, frame);
    marks.probeX = probe.x;
    marks.probeY = probe.y;
    marks.pinned = probe.pinned;
    marks.slots = this.charted;
    const contacts = this.contactsOfFrame?.contacts ?? null;
    marks.centred = !this.contacts || this.held.kind !== "now";
    if (contacts !== this._found) marks.contacts = contacts?.slice(0, MAX_ROWS) ?? null;
    this._found = contacts;
    for (const each of marks.contacts ?? []) if (!marks.labels.has(each.id)) marks.labels.set(each.id, this._labelOf(each)); // a new one
    marks.outline.update(frame, session.plane, contacts, MAX_ROWS);
    marks.outlined = marks.contacts?.length ? frame.sequence : -1;
  }

  /**
   * @param {Frame} frame
   * @param {Session|PlaybackSession} session
   * @param {number} now ms
   * @returns {Float32Array|null} of each restored cell
   */
  _deviation(frame, session, now) {
    if (!this.sectionSeen || this.held.kind !== "now") return null;
    if (!session.paused) session.deviations.request(frame, now);
    const deviation = session.deviations.at(frame.timestamp);
    return deviation && unitOf(deviation.unit) === frame.unit ? deviation.values : null;
  }

  /** The window has another size. */
  layout() {
    this.maps.layout();
    this.regions?.layout(this.maps.zoom);
    this.kernel.draw();
    this._paint(performance.now()); // a canvas of another size is empty
  }

  /** The theme is another. */
  restyle() {
    for (const each of [this.section, this.forces, this.latencies, this.kernel]) each.chart.restyle();
    this.maps.layout();
    this.kernel.draw();
    if (this.frame) this.range.show(peakOf(this.frame, this.view), noiseOf(this.frame)); // other images may be in view
    this.refresh();
  }

  /** @param {boolean} visible */
  showContacts(visible) {
    this.contacts = visible;
    this.session?.ask(visible, this.shear);
    this.refresh();
  }

  /** @param {boolean} visible */
  showShear(visible) {
    this.shear = visible;
    this.session?.ask(this.contacts, visible);
    this.refresh();
  }

  /** Let the cross-section run along an axis. @param {Axis} axis */
  setSectionAxis(axis) {
    this.marks.along = axis;
    this.marks.lineAt = NaN;
    this.refresh();
    this._listener.onChange();
  }

  /** Watch no sensor. */
  leave() {
    this._selection += 1;
    this.session?.stop();
    this.session = null;
    this.name = "";
    this._fresh = false;
    this.marks.lineAt = NaN;
    this.marks.contacts = this._found = null;
    this.pace.reset();
    this.probe.clear();
    this.held.reset();
    for (const range of this.ranges) range.reset();
    if (this.time.zoomed) this.time.reset(this.time.span); // of another sensor that time is not known
    this.maps.clear();
    for (const each of [this.section, this.forces, this.latencies]) each.chart.clear();
    this.kernel.use(null);
  }

  /** Watch another sensor. @param {string} name */
  async select(name) {
    if (name === this.name) return;
    this.leave();
    this.name = name;
    this._listener.onChange();
    const mine = this._selection;
    try {
      const [geometry, sensor, recorded] = await Promise.all([api.geometry(name), api.sensor(name), this.source?.(name) ?? null]);
      if (mine !== this._selection) return;
      this._open(sensor, new Plane(geometry), recorded);
      await this.loadKernel();
    } catch (error) {
      if (mine !== this._selection) return;
      this.name = "";
      notice(`${name}: ${messageOf(error)}`, true);
    }
  }

  /** Show the cover as it is now. */
  async loadKernel() {
    const { name, _selection: mine } = this;
    try {
      const kernel = await api.kernel(name);
      if (mine === this._selection) this.kernel.use(kernel);
    } catch (error) {
      if (mine === this._selection) notice(`Cover of ${name}: ${messageOf(error)}`, true);
    }
  }

  /** Watch a sensor again, which is another than it was. @param {string} name */
  reopen(name) {
    this.leave();
    this.select(name);
  }

  /** @param {Sensor} sensor @param {Plane} plane @param {Played|null} recorded what is watched in its place */
  _open(sensor, plane, recorded) {
    const { name } = sensor;
    this.maps.use(plane);
    this.section.use(plane);
    this.marks.along = plane.along;
    this.session = recorded ? new PlaybackSession(name, plane, kindsOf(sensor), this.contacts, this.shear, recorded, {
      onFrame: (frame) => this._take(frame),
      onChange: () => {
        this._listener.onChange();
        this.refresh();
      },
    }) : this._live(sensor, plane);
    this.view.fixRange(this.unit);
    if (this.session instanceof PlaybackSession) this._listener.onPlayback(this.session);
    const { history } = this.session;
    this.forces.use([["raw", history.trace.rawForces], ["restored", history.trace.restoredForces]]);
    this.latencies.use([["accent", history.latencies]]);
    this.regions?.layout(this.maps.zoom);
    this.refresh();
    this._listener.onChange();
  }

  /** @param {Sensor} sensor @param {Plane} plane @returns {Session} */
  _live(sensor, plane) {
    const { name, unit } = sensor;
    const session = new Session(name, plane, kindsOf(sensor), this.contacts, this.shear, {
      onFrame: (frame, resumed) => {
        this._take(frame);
        if (resumed) this._listener.onChange();
      },
      onStatus: (status, changed) => {
        this._listener.onStatus(status);
        if (!changed) return;
        this._listener.onChange();
        this.refresh();
      },
      onCalibration: () => this.loadKernel(),
      onLink: () => this._listener.onChange(),
      onContacts: () => {
        this._fit(); // of a pause that has just begun, which stands at a frame whose contacts have come
        this.refresh();
      },
      onOtherShape: () => this.reopen(name),
    });
    session.unit = unitOf(unit);
    return session;
  }

  /** @param {Frame} frame */
  _take(frame) {
    const { session } = this;
    if (session) this.held.push(frame, session.plane);
    if (session?.paused) this._fit(); // a recording's frame comes some time after it was sought
    else this.range.follow(peakOf(this.frame ?? frame, this.view), noiseOf(frame), frame.timestamp);
    this._fresh = true;
    this.refresh();
  }

  /** Fit an automatic range to the frame that is paused. */
  _fit() {
    const frame = this.session?.paused ? this.frame : null;
    if (frame) this.range.show(peakOf(frame, this.view), noiseOf(frame));
  }

  /** @param {boolean} to */
  pause(to) {
    this.session?.pause(to);
    this._fit();
    this.refresh();
    this._listener.onChange();
  }

  /** Show another kept frame. @param {number} steps back where negative */
  step(steps) {
    const { session } = this;
    if (session instanceof PlaybackSession) session.pause(true);
    if (session && (session.paused || steps < 0)) this.show(session.back - steps); // nothing is newer than live
  }

  /** @param {number} back from the newest frame */
  show(back) {
    this.session?.show(back);
    this._fit();
    this.refresh();
    this._listener.onChange();
  }
}

/** @param {Session|PlaybackSession} session @returns {number} how far back in the history the frame is that it shows */
const placeOf = (session) => (session instanceof Session ? session.back + session.freshness.heldBack : 0);

/** @param {Frame} frame @param {View} view @returns {number} the highest pressure that the images in view know */
const peakOf = ({ ofRaw, ofRestored }, { name }) => Math.max((name !== "restored" && ofRaw.highest) || 0, (name !== "raw" && ofRestored.highest) || 0);

/** @param {Frame} frame @returns {number} the larger noise of both images; 0 where it is unknown */
const noiseOf = ({ noise, noiseGain }) => (Number.isFinite(noise) ? noise : 0) * Math.max(1, Number.isFinite(noiseGain) ? noiseGain : 1);
