/** The result of a calibration: figures beside the ones before, and measured against fitted response. @module */

import { coverNotes, coverRows, gainRows, verdict } from "./calibration_text.js";
import { Chart, line } from "../charts/chart.js";
import { byId, element, setText } from "../shell/dom.js";
import { UNITS } from "../shell/units.js";

/** @import { CalibrationSession } from "../wire/api.js" */
/** @import { Axes, Line } from "../charts/chart.js" */

const MARGIN = 0.06; // of the span, around the points

export class CalibrationResult {
  constructor() {
    this._chart = new Chart(/** @type {HTMLCanvasElement} */ (byId("calibrate-chart")));
    this._key = "";
    /** @type {CalibrationSession|null} */
    this._session = null;
    new ResizeObserver(() => this._draw()).observe(byId("calibrate-chart"));
  }

  /** Take the colours of the theme as it is now. */
  restyle() {
    this._chart.restyle();
    this._draw();
  }

  /** @param {CalibrationSession} session that is fitted */
  show(session) {
    const { cover, gain } = session;
    const key = JSON.stringify([cover, gain]);
    if (key === this._key) return;
    this._key = key;
    this._session = session;
    setText(byId("calibrate-verdict"), verdict(session));
    const rows = cover ? coverRows(cover) : gain ? gainRows(gain) : [];
    byId("calibrate-result").querySelector("tbody")?.replaceChildren(...rows.map(([name, ...cells]) => {
      const head = element("th", "", name);
      head.scope = "row";
      return element("tr", "", head, ...cells.map((each) => element("td", "", each)));
    }));
    const notes = cover ? coverNotes(cover, session.way) : gain?.notes ?? [];
    byId("calibrate-notes").replaceChildren(...notes.map((each) => element("li", "", each)));
    const failed = Boolean(cover?.reason);
    for (const each of byId("calibrate-result").querySelectorAll("table, #calibrate-apply")) /** @type {HTMLElement} */ (each).hidden = failed;
    this._draw();
  }

  _draw() {
    const session = this._session;
    const canvas = byId("calibrate-chart");
    const drawn = session && !session.cover?.reason && chartOf(session);
    canvas.hidden = !drawn;
    /** @type {HTMLElement} */ (byId("calibrate-result").querySelector(".key")).hidden = !drawn;
    if (drawn && canvas.clientWidth) this._chart.draw(drawn.axes, drawn.lines);
  }
}

/**
 * What is drawn of a result.
 * @param {CalibrationSession} session
 * @returns {{axes: Axes, lines: Line[]}|null}
 */
export function chartOf({ cover, gain }) {
  const data = cover?.line
    ? { x: cover.line.x_mm, measured: cover.line.measured, fitted: cover.line.fitted, along: "mm from the press", up: "over the peak" }
    : gain && { x: gain.line.counts, measured: gain.line.measured_kpa, fitted: gain.line.fitted_kpa, along: "counts over no load", up: UNITS[0] };
  if (!data) return null;
  const points = filled(data.x, data.measured, "raw", "points");
  const curve = filled(data.x, data.fitted, "restored", "plain");
  const [left, right] = ends([points.x, curve.x]);
  const [bottom, top] = ends([points.y, curve.y]);
  return { axes: { left, right, bottom: Math.min(0, bottom), top, x: data.along, y: data.up }, lines: [curve, points] };
}

/**
 * @param {(number|null)[]} x
 * @param {(number|null)[]} y null: left out
 * @param {"raw"|"restored"} ink
 * @param {"plain"|"points"} style
 * @returns {Line} in the order of x
 */
function filled(x, y, ink, style) {
  const known = x.map((each, i) => /** @type {[number|null, number|null]} */ ([each, y[i]]))
    .filter((each) => each[0] !== null && each[1] !== null)
    .sort((a, b) => Number(a[0]) - Number(b[0]));
  const made = line(known.length, ink, style);
  made.length = known.length;
  known.forEach((each, i) => { [made.x[i], made.y[i]] = /** @type {[number, number]} */ (each); });
  return made;
}

/** @param {Float64Array[]} all @returns {[number, number]} a range around them */
function ends(all) {
  const values = all.flatMap((each) => [...each]);
  const low = Math.min(...values);
  const high = Math.max(...values);
  const margin = MARGIN * (high - low || 1);
  return [low - margin, high + margin];
}
