/** Regions of the sensor that is watched: their list, their values over time, and the dialog to set one. @module */

import * as api from "../wire/api.js";
import { Chart, gappedLine } from "../charts/chart.js";
import { roundUp } from "./display_range.js";
import { byId, confirmed, element, setText } from "../shell/dom.js";
import { number } from "../shell/format.js";
import { cellAround } from "./geometry.js";
import { RegionDrawing } from "./region_drawing.js";
import { RegionLayer } from "./region_layer.js";
import { cellsIn, measureRegion } from "./region_measure.js";
import { messageOf, notice, withdraw } from "../shell/notice.js";
import { PlaybackSession } from "../playback/playback_session.js";
import { Session } from "../wire/session.js";
import { withToken } from "../wire/token_dialog.js";
import { forceNumber, forceText, pressureText, unitOf, unitOfQuantity } from "../shell/units.js";

/** @import { Measure, Region, Shape } from "../wire/api.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { RegionMeasures } from "./region_measure.js" */
/** @import { Viewer } from "../shell/viewer.js" */

const POLL_MS = 250;
const RETRY_MS = 2000;
const CHART_POINTS = 600;
const MAX_GAP_S = 1; // between two values that the line joins, as in the service's integrals
const LIMIT_DASHES = [6, 4];
const QUIET_MS = 60_000; // after a notice of a threshold that is exceeded again and again
const SHAPES = /** @type {Shape[]} */ (["rectangle", "ellipse", "polygon"]);

export class Regions {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this._viewer = viewer;
    /** @type {Region[]} */
    this._regions = [];
    /** @type {Map<string, number>} when a threshold was last told of, ms */
    this._told = new Map();
    /** @type {{plane: Plane, shapes: string, cells: number[][]}|null} the regions' cells */
    this._inside = null;
    /** @type {(RegionMeasures|null)[]} of each, in the frame that is shown */
    this._values = [];
    /** @type {boolean[]} which are above their threshold in the frame that is shown; of a live one that does not tell, as the service says */
    this._exceeded = [];
    this._sensor = ""; // whose regions are in the list; another one than is watched until the next look
    this._owner = ""; // sensor of the region in the dialog
    const { raw, restored, difference } = viewer.maps;
    this._layers = [raw, restored, difference].map((each) => new RegionLayer(each.frame));
    this._drawing = new RegionDrawing([raw, restored, difference], () => viewer.probe.pinned ? [viewer.probe.x, viewer.probe.y] : null, () => this._draw(), (shape, points) => this._drawn(shape, points));
    this._body = /** @type {HTMLTableSectionElement} */ (byId("regions").querySelector("tbody"));
    this._dialog = /** @type {HTMLDialogElement} */ (byId("region"));
    this._name = /** @type {HTMLInputElement} */ (byId("region-name"));
    this._span = /** @type {HTMLSelectElement} */ (byId("region-span"));
    this._limit = /** @type {HTMLSelectElement} */ (byId("region-limit"));
    this._above = /** @type {HTMLInputElement} */ (byId("region-above"));
    this._below = /** @type {HTMLInputElement} */ (byId("region-below"));
    this._chart = new Chart(/** @type {HTMLCanvasElement} */ (byId("region-chart")));
    /** The newest bringing up to date of the dialog. @type {Promise<void>} */
    this._plotting = Promise.resolve();
    /** @type {{shape: Shape, points_mm: [number, number][], name?: string}|null} in the dialog */
    this._chosen = null;
    this._nextAt = 0; // ms, of the next look
    this._still = ""; // what the dialog's chart shows of a pause: it stands still then
    for (const shape of SHAPES) byId(`region-${shape}`).addEventListener("click", () => this._toggle(shape));
    byId("region-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this._save();
    });
    byId("region-delete").addEventListener("click", (event) => confirmed(/** @type {HTMLButtonElement} */ (event.currentTarget)) && this._act("Not deleted", (name) => api.removeRegion(this._owner, name), true));
    byId("region-reset").addEventListener("click", () => this._act("Not reset", (name) => api.resetRegion(this._owner, name), false));
    byId("region-close").addEventListener("click", () => this._dialog.close());
    byId("region-form").addEventListener("input", () => setText(byId("region-close"), "Cancel")); // of what was changed
    this._dialog.addEventListener("close", () => this._draw());
    this._span.addEventListener("change", () => this._plot());
    this._limit.addEventListener("change", () => this._showLimit());
    for (const each of [this._above, this._below]) each.addEventListener("input", () => [this._above, this._below].forEach((field) => field.setCustomValidity("")));
    setInterval(() => this._look(), POLL_MS);
  }

  /** Draw a shape on the maps, which come into view, or no longer. @param {Shape} shape */
  _toggle(shape) {
    if (this._drawing.shape === shape) {
      this._drawing.end();
      return;
    }
    window.scrollTo({ top: 0 });
    this._drawing.start(shape);
  }

  /** @returns {string[]} of the regions in the list */
  get names() {
    return this._regions.map((each) => each.name);
  }

  /** The maps have another size. @param {number} zoom CSS px per mm */
  layout(zoom) {
    const { session } = this._viewer;
    if (!session) return;
    for (const each of this._layers) each.resize(session.plane, zoom);
    this._draw();
  }

  /** Look for changes, one look after the other, and not often at a service that does not answer. */
  async _look() {
    if (performance.now() < this._nextAt) return;
    this._nextAt = Infinity;
    let answered = false;
    try {
      answered = await this._poll();
    } finally {
      this._nextAt = performance.now() + (answered ? 0 : RETRY_MS);
    }
  }

  /** @returns {Promise<boolean>} the service answers, as far as is known */
  async _poll() {
    const { name } = this._viewer;
    if (document.hidden || byId("main").hidden) return true;
    if (name !== this._sensor) this._take(name, []);
    if (!name) return true;
    try {
      const regions = await api.regions(name);
      if (name === this._viewer.name) this._take(name, regions);
    } catch {
      return false; // the page says already that the service does not answer
    }
    if (this._dialog.open) {
      this._showLimit();
      await this._plot();
    }
    return true;
  }

  /** @returns {string} what differs where a region is another */
  get shapes() {
    return JSON.stringify(this._regions.map(({ name, shape, points_mm }) => [name, shape, points_mm]));
  }

  /** @returns {Record<string, Region["threshold"]>} of the regions by name; null: none */
  get thresholds() {
    return Object.fromEntries(this._regions.map(({ name, threshold }) => [name, threshold]));
  }

  /** Bring the values up to date with the frame that is shown. */
  read() {
    const { session, name, frame, held } = this._viewer;
    const { plane = null } = session ?? {};
    if (this._sensor !== name) return;
    if (plane && (this._inside?.plane !== plane || this._inside.shapes !== this.shapes)) {
      this._inside = { plane, shapes: this.shapes, cells: this._regions.map((each) => cellsIn(each, plane.restored)) };
    }
    const inside = this._inside?.cells ?? [];
    this._values = this._regions.map((_, i) => {
      const { cells } = this._body.rows[i];
      const now = frame && plane && measureRegion(inside[i], frame, plane.restored);
      setText(cells[1], now?.force == null ? "–" : forceNumber(now.force, session?.unit ?? 0));
      setText(cells[2], now?.mean == null ? "–" : number(now.mean));
      setText(cells[3], now?.peak == null ? "–" : number(now.peak));
      setText(cells[4], now?.area == null ? "–" : number(now.area));
      return now ?? null;
    });
    const live = session instanceof Session && !session.paused;
    const exceeded = this._regions.map((region, i) => held.kind === "now" && isAbove(region, this._values[i], live && region.exceeded));
    if (String(exceeded) === String(this._exceeded)) return;
    this._exceeded = exceeded;
    this._draw();
  }

  /** @returns {[string, RegionMeasures|null][]} what each holds in the frame that is shown */
  measured() {
    this.read();
    return this._regions.map(({ name }, i) => [name, this._values[i] ?? null]);
  }

  /** @param {string} sensor @param {Region[]} watched */
  _take(sensor, watched) {
    const { session } = this._viewer;
    for (const { name, threshold, exceeded, unit } of session instanceof PlaybackSession ? [] : watched) {
      if (!threshold) continue;
      const text = `${sensor}: ${threshold.quantity} in region ${name} is above ${threshold.above} ${unitOfQuantity(threshold.quantity, unitOf(unit))}`;
      if (!exceeded) withdraw(text);
      else if (!(sensor === this._sensor && this._regions.some((each) => each.name === name && each.exceeded)) && performance.now() - (this._told.get(text) ?? -Infinity) > QUIET_MS) {
        this._told.set(text, performance.now());
        notice(text, true);
      }
    }
    this._sensor = sensor;
    const regions = this._regions = watched;
    byId("regions").hidden = !regions.length;
    while (this._body.rows.length < regions.length) this._body.append(this._row());
    while (this._body.rows.length > regions.length) this._body.deleteRow(-1);
    regions.forEach(({ name }, i) => setText(/** @type {Element} */ (this._body.rows[i].cells[0].firstElementChild), name));
    this.read();
    this._draw();
  }

  /** @returns {HTMLTableRowElement} */
  _row() {
    const button = element("button", "link");
    button.type = "button";
    button.addEventListener("click", () => {
      const region = this._regions.find((each) => each.name === button.textContent);
      if (region) this._open(region, this._sensor);
    });
    const head = element("th", "", button);
    head.scope = "row";
    return element("tr", "", head, ...Array.from({ length: 4 }, () => element("td", "")));
  }

  _draw() {
    const { shape, points, closable } = this._drawing;
    for (const each of SHAPES) {
      const button = byId(`region-${each}`);
      button.setAttribute("aria-pressed", String(each === shape));
      setText(button, each !== shape ? each[0].toUpperCase() + each.slice(1) : closable ? "Done" : "Cancel");
    }
    const asked = this._dialog.open && this._chosen && this._chosen.name === undefined ? this._chosen : null; // of a new region
    const drawn = asked ?? (shape && points.length ? { shape, points_mm: points } : null);
    const { charted } = this._viewer;
    const outlines = this._regions.map((each, i) => ({ ...each, exceeded: this._exceeded[i] ?? false, slot: charted?.get(`region ${each.name}`) }));
    outlines.forEach(({ exceeded }, i) => this._body.rows[i].classList.toggle("some", exceeded));
    const [names] = this._layers.map((each) => each.draw(drawn ? [...outlines, { ...drawn, name: "", exceeded: false }] : outlines));
    if (JSON.stringify(names) === JSON.stringify(this._viewer.marks.names)) return;
    this._viewer.marks.names = names;
    this._viewer.refresh();
  }

  /** Open the dialog for a new region: what was drawn, or the cell that was clicked. @param {Shape} shape @param {[number, number][]} points */
  _drawn(shape, points) {
    const { session, name } = this._viewer;
    const cell = shape !== "polygon" && session ? cellAround(session.plane, points) : null;
    this._open(cell ? { shape: "rectangle", points_mm: cell.corners } : { shape, points_mm: points }, name);
    if (!cell) return;
    setText(byId("region-title"), "New region: one cell");
    this._name.value = cell.name;
  }

  /**
   * @param {{shape: Shape, points_mm: [number, number][], name?: string, threshold?: Region["threshold"]}} region
   * @param {string} sensor
   */
  _open(region, sensor) {
    this._chosen = region;
    this._owner = sensor;
    const isNew = region.name === undefined;
    setText(byId("region-title"), isNew ? `New region: ${region.shape}` : `Region ${region.name}`);
    this._name.value = region.name ?? "";
    this._name.readOnly = !isNew;
    this._limit.value = region.threshold?.quantity ?? "";
    this._above.value = String(region.threshold?.above ?? "");
    this._below.value = String(region.threshold?.below ?? "");
    byId("region-held").hidden = byId("region-reset").hidden = isNew || this._viewer.session instanceof PlaybackSession;
    byId("region-delete").hidden = isNew;
    setText(byId("region-close"), isNew ? "Cancel" : "Close");
    this._showLimit();
    this._dialog.showModal();
    this._draw();
    if (isNew) this._name.focus();
    else this._plot();
  }

  _showLimit() {
    const quantity = /** @type {Measure|""} */ (this._limit.value);
    byId("region-limits").hidden = !quantity;
    if (!quantity) return;
    const { session, frame, unit } = this._viewer;
    const unitText = unitOfQuantity(quantity, unit);
    for (const each of this._dialog.querySelectorAll(".limit-unit")) setText(each, unitText);
    const cells = session?.plane.restored;
    const now = this._chosen && frame && cells && measureRegion(cellsIn(this._chosen, cells), frame, cells);
    setText(byId("region-now"), now && !Number.isNaN(now[quantity]) ? `Now it is ${quantity === "force" ? forceNumber(now.force, unit) : number(now[quantity])} ${unitText}.` : "");
  }

  async _save() {
    const { _chosen: chosen, _name: { value: name } } = this;
    if (!chosen) return;
    const quantity = /** @type {Measure|""} */ (this._limit.value);
    const above = this._above.valueAsNumber;
    if (quantity && Number.isNaN(above)) {
      this._above.setCustomValidity("Give the value above which it is reported.");
      this._above.reportValidity();
      return;
    }
    const below = this._below.value ? { below: this._below.valueAsNumber } : {};
    if (quantity && Number(below.below) > above) {
      this._below.setCustomValidity("Give a value that is not above the one that alerts.");
      this._below.reportValidity();
      return;
    }
    const threshold = quantity ? { quantity, above, ...below } : null;
    const { shape, points_mm } = chosen;
    if (chosen.name === undefined && this._regions.some((each) => each.name === name)) {
      notice(`There is a region ${name}: give another name.`, true);
    } else if (await withToken(() => api.putRegion(this._owner, name, { shape, points_mm, threshold }), "Region not saved")) {
      this._dialog.close();
    }
    await this._poll();
  }

  /** @param {string} failed @param {(name: string) => Promise<unknown>} action @param {boolean} close at once: nothing asks for what is deleted */
  async _act(failed, action, close) {
    const name = this._chosen?.name;
    if (close) this._dialog.close();
    await this._plotting; // or its request may come after the region has ended
    if (name !== undefined) await withToken(() => action(name), failed);
    await this._poll();
  }

  /** Bring the dialog's chart and values up to date. @returns {Promise<void>} */
  _plot() {
    this._plotting = this._plotted();
    return this._plotting;
  }

  async _plotted() {
    const region = this._regions.find((each) => each.name === this._chosen?.name);
    if (!region || byId("region-held").hidden) return;
    const unit = unitOf(region.unit);
    const { highest, impulse, pressure_time, since, threshold } = region;
    const { quantity = "force", above = NaN } = threshold ?? {};
    setText(byId("region-charted"), `${quantity[0].toUpperCase()}${quantity.slice(1)} over the last`);
    setText(byId("region-since"), since === null ? "" : `Since ${new Date(1000 * since).toLocaleTimeString([], { hour12: false })}`);
    const texts = highest?.force == null || highest.peak == null ? ["–", "–", "–", "–"] : [
      forceText(highest.force, unit), pressureText(highest.peak, unit), `${forceText(impulse, unit)}·s`, `${pressureText(pressure_time, unit)}·s`,
    ];
    ["force", "peak", "impulse", "integral"].forEach((id, i) => setText(byId(`region-${id}`), texts[i]));
    const span = Number(this._span.value);
    const { session } = this._viewer;
    const until = session instanceof Session ? session.until : null;
    const still = until === null ? "" : [region.name, span, until, quantity, above].join();
    const link = /** @type {HTMLAnchorElement} */ (byId("region-csv"));
    link.href = api.regionCsv(this._owner, region.name, span, until);
    link.download = `${this._owner}-${region.name}.csv`;
    if (still && still === this._still) return;
    try {
      const { time, [quantity]: values = [] } = await api.regionSeries(this._owner, region.name, span, until, CHART_POINTS);
      const of = gappedLine(time, values, MAX_GAP_S + span / CHART_POINTS, "restored");
      of.zero = time[time.length - 1] ?? 0;
      this._still = still;
      const limit = gappedLine([-span, 0], [above, above], Infinity, "accent", LIMIT_DASHES);
      const least = unit ? 100 : quantity === "force" ? 0.1 : 1; // so that noise does not fill the chart
      const top = roundUp(Math.max(least, ...[above, ...of.y].filter(Number.isFinite)));
      this._chart.draw({ left: -span, right: 0, bottom: 0, top, x: "time, s", y: unitOfQuantity(quantity, unit) }, [limit, of]);
    } catch (error) {
      notice(`Series of ${region.name}: ${messageOf(error)}`, true);
    }
  }
}

/** @param {Region} region @param {RegionMeasures|null} value of it in a frame @param {boolean} between whether it is where the value does not tell @returns {boolean} */
function isAbove({ threshold }, value, between) {
  if (!threshold) return false;
  const of = value?.[threshold.quantity] ?? null;
  return of === null ? between : of > threshold.above || (between && of >= threshold.below);
}
