/** Regions of the sensor that is watched: their list, their values over time, and the dialog to set one. @module */

import * as api from "./api.js";
import { Chart, line } from "./chart.js";
import { roundUp } from "./display_range.js";
import { byId, element, setText } from "./dom.js";
import { fixed } from "./format.js";
import { RegionDrawing } from "./region_drawing.js";
import { RegionLayer } from "./region_layer.js";
import { messageOf, notice } from "./notice.js";
import { withToken } from "./token_dialog.js";
import { FORCE_UNITS, UNITS, forceNumber, forceText, pressureText, unitOf } from "./units.js";

/** @import { Region, Shape } from "./api.js" */
/** @import { Viewer } from "./viewer.js" */

const POLL_MS = 500;
const CHART_POINTS = 600;
const SHAPES = /** @type {Shape[]} */ (["rectangle", "ellipse", "polygon"]);

export class Regions {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this._viewer = viewer;
    /** @type {Region[]} */
    this._regions = [];
    this._sensor = ""; // whose regions are in the list; another one than is watched until the next look
    this._owner = ""; // sensor of the region in the dialog
    const { raw, restored } = viewer.maps;
    this._layers = [raw, restored].map((each) => new RegionLayer(each.frame));
    this._drawing = new RegionDrawing([raw, restored], () => this._draw(), (shape, points) => this._open({ shape, points_mm: points }, viewer.name));
    this._body = /** @type {HTMLTableSectionElement} */ (byId("regions").querySelector("tbody"));
    this._dialog = /** @type {HTMLDialogElement} */ (byId("region"));
    this._name = /** @type {HTMLInputElement} */ (byId("region-name"));
    this._span = /** @type {HTMLSelectElement} */ (byId("region-span"));
    this._limit = /** @type {HTMLSelectElement} */ (byId("region-limit"));
    this._above = /** @type {HTMLInputElement} */ (byId("region-above"));
    this._below = /** @type {HTMLInputElement} */ (byId("region-below"));
    this._chart = new Chart(/** @type {HTMLCanvasElement} */ (byId("region-chart")));
    /** @type {{shape: Shape, points_mm: [number, number][], name?: string}|null} in the dialog */
    this._chosen = null;
    for (const shape of SHAPES) byId(`region-${shape}`).addEventListener("click", () => this._drawing.start(shape));
    byId("region-save").addEventListener("click", () => this._save());
    byId("region-delete").addEventListener("click", () => this._act("Not deleted", (name) => api.removeRegion(this._owner, name), true));
    byId("region-reset").addEventListener("click", () => this._act("Not reset", (name) => api.resetRegion(this._owner, name), false));
    byId("region-close").addEventListener("click", () => this._dialog.close());
    this._span.addEventListener("change", () => this._plot());
    this._limit.addEventListener("change", () => this._showLimit());
    setInterval(() => this._poll(), POLL_MS);
  }

  /** The maps have another size. @param {number} zoom CSS px per mm */
  layout(zoom) {
    const { session } = this._viewer;
    if (!session) return;
    for (const each of this._layers) each.resize(session.plane, zoom);
    this._draw();
  }

  async _poll() {
    const { name } = this._viewer;
    if (document.hidden || byId("main").hidden) return;
    if (name !== this._sensor) this._take(name, []);
    if (!name) return;
    try {
      const regions = await api.regions(name);
      if (name === this._viewer.name) this._take(name, regions);
    } catch {
      return; // the page says already that the service does not answer
    }
    if (this._dialog.open) await this._plot();
  }

  /** @param {string} sensor @param {Region[]} regions */
  _take(sensor, regions) {
    this._sensor = sensor;
    this._regions = regions;
    byId("regions").hidden = !regions.length;
    while (this._body.rows.length < regions.length) this._body.append(this._row());
    while (this._body.rows.length > regions.length) this._body.deleteRow(-1);
    regions.forEach(({ name, unit, now, exceeded }, i) => {
      const { cells } = this._body.rows[i];
      this._body.rows[i].classList.toggle("some", exceeded);
      setText(/** @type {Element} */ (cells[0].firstElementChild), name);
      const of = unitOf(unit);
      setText(cells[1], now?.force == null ? "–" : forceNumber(now.force, of));
      setText(cells[2], now?.mean == null ? "–" : fixed(now.mean, 1));
      setText(cells[3], now?.peak == null ? "–" : fixed(now.peak, 0));
      setText(cells[4], now?.area == null ? "–" : fixed(now.area, 0));
    });
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
    const { shape, points } = this._drawing;
    const drawn = shape && points.length ? [{ name: "", shape, points_mm: points, exceeded: false }] : [];
    for (const each of this._layers) each.draw([...this._regions, ...drawn]);
  }

  /**
   * @param {{shape: Shape, points_mm: [number, number][], name?: string, threshold?: Region["threshold"]}} region
   * @param {string} sensor
   */
  _open(region, sensor) {
    this._chosen = region;
    this._owner = sensor;
    const unit = this._viewer.unit;
    const isNew = region.name === undefined;
    setText(byId("region-title"), isNew ? `New region: ${region.shape}` : `Region ${region.name}`);
    this._name.value = region.name ?? "";
    this._name.readOnly = !isNew;
    this._limit.value = region.threshold?.quantity ?? "";
    for (const option of this._limit.options) {
      option.textContent = { force: `force, ${FORCE_UNITS[unit]}`, mean: `mean, ${UNITS[unit]}`, peak: `peak, ${UNITS[unit]}`, area: "area, mm²" }[option.value] ?? "none";
    }
    this._above.value = String(region.threshold?.above ?? "");
    this._below.value = String(region.threshold?.below ?? "");
    byId("region-held").hidden = isNew;
    for (const id of ["region-delete", "region-reset"]) byId(id).hidden = isNew;
    this._showLimit();
    this._dialog.showModal();
    if (isNew) this._name.focus();
    else this._plot();
  }

  _showLimit() {
    byId("region-limits").hidden = !this._limit.value;
  }

  async _save() {
    const { _chosen: chosen, _name: { value: name } } = this;
    if (!chosen) return;
    const quantity = this._limit.value;
    const threshold = quantity ? { quantity, above: this._above.valueAsNumber, below: this._below.valueAsNumber } : null;
    const { shape, points_mm } = chosen;
    if (chosen.name === undefined && this._regions.some((each) => each.name === name)) {
      notice(`There is a region ${name}: give another name.`, true);
    } else if (await withToken(() => api.putRegion(this._owner, name, { shape, points_mm, threshold }), "Region not saved")) {
      this._dialog.close();
    }
    await this._poll();
  }

  /** @param {string} failed @param {(name: string) => Promise<unknown>} action @param {boolean} close */
  async _act(failed, action, close) {
    const name = this._chosen?.name;
    if (name !== undefined && await withToken(() => action(name), failed) && close) this._dialog.close();
    await this._poll();
  }

  /** Bring the dialog's chart and values up to date. */
  async _plot() {
    const region = this._regions.find((each) => each.name === this._chosen?.name);
    if (!region) return;
    const unit = unitOf(region.unit);
    const { highest, impulse, pressure_time } = region;
    const texts = highest?.force == null || highest.peak == null ? ["–", "–", "–", "–"] : [
      forceText(highest.force, unit), pressureText(highest.peak, unit), `${forceText(impulse, unit)}·s`, `${pressureText(pressure_time, unit)}·s`,
    ];
    ["force", "peak", "impulse", "integral"].forEach((id, i) => setText(byId(`region-${id}`), texts[i]));
    const seconds = Number(this._span.value);
    /** @type {HTMLAnchorElement} */ (byId("region-csv")).href = api.regionCsv(this._owner, region.name, seconds);
    try {
      const { time, force } = await api.regionSeries(this._owner, region.name, seconds, CHART_POINTS);
      const of = line(time.length, "restored");
      of.length = time.length;
      of.zero = time[time.length - 1] ?? 0;
      time.forEach((each, i) => {
        of.x[i] = each;
        of.y[i] = force[i] ?? NaN;
      });
      const top = roundUp(Math.max(unit ? 100 : 0.1, ...of.y.filter(Number.isFinite)));
      this._chart.draw({ left: -seconds, right: 0, bottom: 0, top, x: "time, s", y: FORCE_UNITS[unit] }, [of]);
    } catch (error) {
      notice(`Series of ${region.name}: ${messageOf(error)}`, true);
    }
  }
}
