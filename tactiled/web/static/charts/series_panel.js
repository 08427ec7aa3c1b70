/** The panel of series: chosen contacts and regions in one chart over time, and as CSV. @module */

import * as api from "../wire/api.js";
import { Chart, gappedLine } from "./chart.js";
import { zoomable } from "./chart_zoom.js";
import { roundUp } from "../maps/display_range.js";
import { byId, element } from "../shell/dom.js";
import { download } from "../export/download.js";
import { seriesCsv } from "../export/export_csv.js";
import { messageOf, notice } from "../shell/notice.js";
import { provenance } from "../export/provenance.js";
import { Session } from "../wire/session.js";
import { FORCE_SCALES, unitOf, unitOfQuantity } from "../shell/units.js";

/** @import { Quantity, Series } from "../wire/api.js" */
/** @import { Axes, Line } from "./chart.js" */
/** @import { Ink } from "../shell/dom.js" */
/** @import { Viewer } from "../shell/viewer.js" */

const POLL_MS = 500;
const CHART_POINTS = 600; // of a region
const MAX_POINTS = 60_000;
const MAX_REACH_S = 600;
const AHEAD_S = 1; // by which the service may be ahead of this page
const SETTLED_READS = 10; // in a pause: contacts of its last frames come late
const OFFERED_SPANS = new Set(["10", "60", "600"]);
const MAX_OFFERED = 8; // contacts: those that are listed, then the newest
const MAX_GAPS_S = { contact: 0.5, region: 1 }; // between two values that a line joins; of regions as in the service's integrals
const MAX_GAP_FRAMES = 3; // the same of a slow sensor
const DASHES = [[], [8, 4], [2, 3], [12, 3, 2, 3], [5, 3], [12, 5]]; // of each slot, for who does not see its colour

export class SeriesPanel {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this._viewer = viewer;
    /** @type {Map<string, number>} slots of what is chosen, by "contact 3" or "region heel" */
    this._slots = new Map();
    /** @type {Session|null} whose contacts they are */
    this._session = null;
    this._offered = this._listed = "";
    /** @type {{axes: Axes, lines: Line[]}|null} what was read last */
    this._drawn = null;
    /** @type {{shown: string, reads: number, all: Map<string, Series>}} what was read last, of which part of what, and how often */
    this._kept = { shown: "", reads: 0, all: new Map() };
    this._add = /** @type {HTMLSelectElement} */ (byId("plot-add"));
    this._quantity = /** @type {HTMLSelectElement} */ (byId("plot-quantity"));
    this._span = /** @type {HTMLSelectElement} */ (byId("plot-span"));
    this.chart = new Chart(/** @type {HTMLCanvasElement} */ (byId("plot-chart")));
    this._add.addEventListener("change", () => {
      this._toggle(this._add.value);
      this._offer();
    });
    this._add.addEventListener("pointerdown", () => this._offer());
    zoomable(this.chart.canvas, () => viewer.time);
    this._quantity.addEventListener("change", () => this._draw());
    this._span.addEventListener("change", () => viewer.time.reset(Number(this._span.value)));
    viewer.onTime = () => this._draw();
    viewer.onTrends = () => this._follow();
    byId("plot-csv").addEventListener("click", () => this._save());
    byId("contact-list").addEventListener("click", (event) => {
      const button = event.target instanceof Element ? event.target.closest("tbody tr")?.querySelector("button") : null;
      if (button && !button.disabled) this._toggle(`contact ${button.textContent}`);
    });
    setInterval(() => this._update(), POLL_MS);
  }

  /** Draw a series, or no longer. @param {string} key */
  _toggle(key) {
    this._slots = new Map(this._slots); // another: labels of contacts have its colours
    const used = [...this._slots.values()];
    const free = DASHES.findIndex((_, slot) => !used.includes(slot));
    if (!this._slots.delete(key)) {
      if (free < 0) notice(`The chart has ${DASHES.length} series: remove one first.`, true);
      else this._slots.set(key, free);
    }
    this._update();
    this._viewer.refresh();
  }

  _update() {
    const { session } = this._viewer;
    if (session !== this._session) {
      this._drawn = null;
      this._session = session instanceof Session ? session : null;
      this._slots = new Map();
    }
    this._viewer.charted = this._session && this._slots;
    const regions = this._regions;
    for (const key of this._slots.keys()) if (!key.startsWith("contact ") && !regions.includes(key)) this._slots.delete(key);
    byId("plot").hidden = !this._slots.size;
    if (document.hidden || byId("main").hidden || !this._session) return;
    if (document.activeElement !== this._add) this._offer();
    this._list();
    if (this._slots.size) this._draw();
  }

  /** @returns {string[]} those that can be added or stay */
  get _regions() {
    return this._viewer.regions?.names.map((name) => `region ${name}`) ?? [];
  }

  /** Bring the list of what can be added up to date. */
  _offer() {
    const listed = this._viewer.contactsOfFrame?.contacts.map(({ id }) => id) ?? [];
    const place = (/** @type {{id: number}} */ { id }) => (listed.includes(id) ? listed.indexOf(id) : listed.length); // the strongest first
    const contacts = (this._session?.series.contacts ?? []).sort((a, b) => place(a) - place(b)).slice(0, MAX_OFFERED);
    const offers = [...this._regions.map((key) => [key, ""]), ...contacts.map(({ id, ended }) => [`contact ${id}`, ended ? ", ended" : ""])]
      .filter(([key]) => !this._slots.has(key));
    const offered = offers.join();
    if (offered === this._offered && this._add.length && !this._add.value) return;
    this._offered = offered;
    this._add.replaceChildren(new Option("Add a region or contact", ""), ...offers.map(([key, more]) => new Option(title(key) + more, key)));
  }

  /** Bring the legend up to date. */
  _list() {
    const listed = [...this._slots.keys()].join();
    if (listed === this._listed) return;
    this._listed = listed;
    byId("plot-key").replaceChildren(...[...this._slots].map(([key, slot]) => {
      const button = element("button", "", swatch(slot), title(key), " ✕");
      button.type = "button";
      button.setAttribute("aria-label", `Remove ${title(key)}`);
      button.addEventListener("click", () => this._toggle(key));
      return element("li", "", button);
    }));
  }

  /** @param {Session} session @param {number} seconds @param {number} points of a region at most @returns {Promise<Map<string, Series>>} by what is chosen */
  async _read(session, seconds, points) {
    return new Map(await Promise.all([...this._slots.keys()].map(async (key) => {
      const name = key.slice(key.indexOf(" ") + 1);
      const series = key.startsWith("contact ") ? session.series.of(Number(name), seconds, session.until) : await api.regionSeries(session.name, name, seconds, session.until, points);
      return /** @type {[string, Series]} */ ([key, unitOf(series.unit) === session.unit ? series : { unit: series.unit, time: [] }]);
    })));
  }

  async _draw() {
    const session = this._session;
    if (!session) return;
    const { time } = this._viewer;
    const [left, right] = time.ends(session.newest);
    const reach = Math.min(MAX_REACH_S, AHEAD_S - left);
    const points = Math.min(MAX_POINTS, Math.ceil((CHART_POINTS * reach) / (right - left)));
    if (OFFERED_SPANS.has(String(time.span))) this._span.value = String(time.span);
    const quantity = /** @type {Quantity} */ (this._quantity.value);
    const shown = [...this._slots.keys(), session.newest, left, right].join();
    const reads = session.paused && this._kept.shown === shown ? this._kept.reads : 0;
    let all = reads < SETTLED_READS ? null : this._kept.all; // a pause may be longer than what the service keeps
    try {
      all ??= await this._read(session, reach, points);
    } catch {
      return; // the page says already that the service does not answer
    }
    if (session !== this._session) return;
    this._kept = { shown, reads: reads + 1, all };
    const { status } = session;
    const frames_s = MAX_GAP_FRAMES / (status?.rate_hz || Infinity);
    const lines = [...all].map(([key, series]) => {
      const slot = this._slots.get(key) ?? 0;
      const isContact = key.startsWith("contact ");
      const maxGap = isContact ? Math.max(MAX_GAPS_S.contact, frames_s) : Math.max(MAX_GAPS_S.region, frames_s) + reach / points;
      return gappedLine(series.time, series[quantity] ?? [], maxGap, /** @type {Ink} */ (`series${slot + 1}`), DASHES[slot]);
    });
    this._drawn = { axes: { left, right, x: "time, s", ...yAxis(quantity, lines.map(({ y }) => y), session) }, lines };
    this._follow();
    const what = `${this._quantity.selectedOptions[0].text} of ${[...all.keys()].map(title).join(", ")}, `;
    this.chart.canvas.setAttribute("aria-label", `${what}${time.text}`);
  }

  /** Draw what was read last along the time axis as it is now: the other charts go on while this one reads. */
  _follow() {
    const { _session: session, _drawn: drawn } = this;
    if (!session || !drawn || !this._slots.size) return;
    const { newest } = session;
    [drawn.axes.left, drawn.axes.right] = this._viewer.time.ends(newest);
    for (const each of drawn.lines) each.zero = newest;
    const { frame, paused } = session;
    this.chart.draw(drawn.axes, drawn.lines, paused && frame ? frame.timestamp - newest : NaN);
  }

  async _save() {
    const session = this._session;
    const frame = session?.frame;
    if (!session || !frame) return;
    try {
      const state = `${session.paused ? "paused" : document.body.dataset.level}, series of the last ${this._span.selectedOptions[0].text}`;
      const text = seriesCsv(await this._read(session, Number(this._span.value), MAX_POINTS), session.unit, provenance(session.name, frame, session.status, state));
      download(session.name, frame, "series.csv", new Blob([text], { type: "text/csv" }));
    } catch (error) {
      notice(`Series not saved: ${messageOf(error)}`, true);
    }
  }
}

/** @param {string} key @returns {string} what a reader calls it */
const title = (key) => key.replace("region ", "");

/**
 * @param {Quantity} quantity
 * @param {Float64Array[]} values
 * @param {Session} session
 * @returns {Pick<Axes, "bottom"|"top"|"y">} the axis that runs up
 */
function yAxis(quantity, values, { plane, unit }) {
  if (quantity === "x" || quantity === "y") {
    const start = plane.start(quantity);
    return { bottom: start, top: start + plane.extent(quantity), y: `${quantity}, mm` };
  }
  const least = quantity === "force" ? 100 * FORCE_SCALES[unit] : 1;
  const highest = values.reduce((top, each) => each.reduce((high, value) => (value > high ? value : high), top), least);
  return { bottom: 0, top: roundUp(highest), y: unitOfQuantity(quantity, unit) };
}

/** @param {number} slot @returns {SVGElement} how its line is drawn */
function swatch(slot) {
  const [svg, path] = /** @type {const} */ (["svg", "path"]).map((each) => document.createElementNS("http://www.w3.org/2000/svg", each));
  svg.setAttribute("aria-hidden", "true");
  path.setAttribute("d", "M0 2H24");
  path.setAttribute("stroke", `var(--series${slot + 1})`);
  path.setAttribute("stroke-dasharray", DASHES[slot].join(" "));
  svg.append(path);
  return svg;
}
