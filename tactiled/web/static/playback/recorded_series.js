/** Force and peak over a whole recording, of the array and of its regions: their highest values, and their chart. @module */

import * as api from "../wire/api.js";
import { byId, element, setText } from "../shell/dom.js";
import { number, positionText } from "../shell/format.js";
import { messageOf } from "../shell/notice.js";
import { methodTitle } from "../shell/readings.js";
import { forceNumber, unitOf, unitOfQuantity } from "../shell/units.js";

/** @import { AreaSeries, RecordedSeries, Region } from "../wire/api.js" */
/** @import { PlaybackSession } from "./playback_session.js" */

const POLL_MS = 1000;
const AGAIN = [0, 409, 429]; // statuses of a service that may measure later
const QUANTITIES = /** @type {const} */ (["force", "peak"]);

/** @typedef {{title: string, unit: string, x: number[], y: (number|null)[], above: number[]}} Curve what the chart draws; where its threshold begins to be exceeded */

/** @param {RecordedSeries} series @returns {AreaSeries[]} the whole array first; none before the end of measuring */
export const areasOf = (series) => (series.total ? [series.total, ...series.regions] : []);

/** @param {AreaSeries} area @param {Region["threshold"]|undefined} threshold @returns {number[]} indices at which its value comes to be above it, as the service's events do */
function crossings(area, threshold) {
  let exceeded = false;
  return !threshold ? [] : area[threshold.quantity].flatMap((value, i) => {
    const was = exceeded;
    if (value !== null) exceeded = was ? value >= threshold.below : value > threshold.above;
    return exceeded && !was ? [i] : [];
  });
}

/** @param {RecordedSeries} series @param {Record<string, Region["threshold"]>} thresholds by region @returns {Curve[]} force and peak of each area in turn */
export function curvesOf(series, thresholds) {
  const unit = unitOf(series.unit);
  return areasOf(series).flatMap((area) => QUANTITIES.map((quantity) =>
    ({ title: `${area.name}, ${quantity}`, unit: unitOfQuantity(quantity, unit), x: series.position_s, y: area[quantity], above: crossings(area, thresholds[area.name]) })));
}

export class RecordedSeriesPanel {
  /** @param {(number: number) => void} show a frame */
  constructor(show) {
    this._show = show;
    /** @type {PlaybackSession|null} */
    this._session = null;
    /** @type {Curve[]} that the chart can show */
    this._curves = [];
    /** @type {RecordedSeries|null} whose highest values are listed */
    this._series = null;
    /** @type {Record<string, Region["threshold"]>} of the regions by name */
    this._thresholds = {};
    this._of = ""; // regions and method that are measured; "" for none
    this._now = ""; // those of the page
    this._turn = 0; // counts up with what is measured, so that answers of before are dropped
    this._choice = /** @type {HTMLSelectElement} */ (byId("series-of"));
    this._body = /** @type {HTMLTableSectionElement} */ (byId("series").querySelector("tbody"));
    byId("series-measure").addEventListener("click", () => this._measure());
  }

  /** @returns {Curve|null} that the chart shows instead of the raw force */
  get curve() {
    return this._curves[this._choice.selectedIndex - 1] ?? null;
  }

  /** Another recording, or none. @param {PlaybackSession|null} session */
  use(session) {
    this._session = session;
    this._turn += 1;
    this._of = "";
    this._list(null);
    setText(byId("series-state"), "");
  }

  /**
   * Measure again where regions or method are others than those that are measured.
   * @param {string} regions
   * @param {Record<string, Region["threshold"]>} thresholds
   */
  read(regions, thresholds) {
    const marked = JSON.stringify(thresholds) === JSON.stringify(this._thresholds);
    this._thresholds = thresholds;
    if (!marked) this._list(this._series);
    this._now = `${this._session?.method} ${regions}`;
    if (this._of && this._of !== this._now) this._measure();
  }

  async _measure() {
    const { _session: session } = this;
    if (!session) return;
    const turn = this._turn += 1;
    this._of = this._now;
    this._list(null);
    for (let running = true; running;) {
      const [series, text, again] = await this._ask(session);
      if (turn !== this._turn) return;
      setText(byId("series-state"), text);
      running = again;
      if (series && !running) this._list(series);
      else if (!running) this._of = "";
      if (running) await new Promise((resolve) => { setTimeout(resolve, POLL_MS); });
    }
  }

  /**
   * @param {PlaybackSession} session
   * @returns {Promise<[RecordedSeries|null, string, boolean]>} what came, how far it is, and whether more comes
   */
  async _ask({ name, method, recorded }) {
    if (recorded.reading) return [null, "Reading the recording …", true];
    try {
      const series = await api.recordedSeries(recorded.name, name, method);
      const { frames, measured, running, error } = series;
      if (error) return [null, `Not measured: ${error}`, false];
      return [series, running ? `${Math.floor((100 * measured) / frames)} % measured` : "", running];
    } catch (error) {
      const again = error instanceof api.ApiError && AGAIN.includes(error.status);
      return [null, again ? "Waiting …" : `Not measured: ${messageOf(error)}`, again];
    }
  }

  /** List the highest values. @param {RecordedSeries|null} series */
  _list(series) {
    const chosen = this._choice.value;
    this._series = series;
    this._curves = series ? curvesOf(series, this._thresholds) : [];
    const titles = this._curves.map((each) => each.title);
    this._choice.replaceChildren(new Option("total force, raw", ""), ...titles.map((each) => new Option(each, each)));
    this._choice.value = titles.includes(chosen) ? chosen : titles[2] ?? titles[0] ?? "";
    this._choice.hidden = byId("series-held").hidden = !series;
    this._body.replaceChildren(...(series ? areasOf(series).map((each) => this._row(series, each)) : []));
    if (!series || !this._session) return;
    setText(byId("series-method"), methodTitle(series.method));
    const { name, recorded, method } = this._session;
    /** @type {HTMLAnchorElement} */ (byId("series-csv")).href = api.recordedSeriesCsv(recorded.name, name, method);
  }

  /** @param {RecordedSeries} series @param {AreaSeries} area @returns {HTMLTableRowElement} */
  _row({ unit }, { name, highest }) {
    const head = element("th", "", name);
    head.scope = "row";
    return element("tr", "", head, ...QUANTITIES.flatMap((quantity) => {
      const { value, number: at, position_s } = highest[quantity];
      if (value === null) return [element("td", "", "–"), element("td", "")];
      const text = quantity === "force" ? forceNumber(value, unitOf(unit)) : number(value);
      const button = element("button", "link", positionText(position_s));
      button.type = "button";
      button.title = `Show frame ${at}, and ${quantity} over the recording`;
      button.addEventListener("click", () => {
        this._choice.value = `${name}, ${quantity}`;
        this._show(at);
      });
      return [element("td", "", text), element("td", "", button)];
    }));
  }
}
