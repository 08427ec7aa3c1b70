/** The cross-section: pressure along a line, raw and restored. @module */

import { Chart, line } from "./chart.js";
import { byId, setText } from "../shell/dom.js";
import { UNITS, lengthText } from "../shell/units.js";
import { steadyTop } from "../maps/display_range.js";
import { ACROSS } from "../maps/geometry.js";

/** @import { Axes, Line } from "./chart.js" */
/** @import { AxisWindow } from "./chart_window.js" */
/** @import { DisplayRange } from "../maps/display_range.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Cells, Plane } from "../maps/geometry.js" */
/** @import { Marks } from "../maps/overlay.js" */

const AXES = { x: "x, mm", y: "y, mm" };
const BAND_DEVIATIONS = 2; // standard deviations to either side of the restored line
const MARGIN = 0.06; // of the range, drawn below it
const DEEP_MARGIN = 0.4; // of the range, drawn below it while something is there
const LINE_STAYS = 0.85; // of the peak that the line must still reach where it is
const DEEP_FRAMES = 180; // frames for which that stays, so that the axis does not jump

export class CrossSection {
  /** @param {HTMLCanvasElement} canvas @param {AxisWindow} part of the axis that is shown */
  constructor(canvas, part) {
    this.chart = new Chart(canvas);
    this._part = part;
    /** @type {Plane|null} */
    this._plane = null;
    this._deep = 0; // frames for which the axis still reaches deep
    this._raw = line(0, "raw");
    this._restored = line(0, "restored");
    this._lines = [this._raw, this._restored];
    this._deviation = line(0, "restored"); // along the same cells
    this._titled = { along: "", at: NaN, pinned: false }; // what the title says
    /** @type {Axes} */
    this._axes = { left: 0, right: 1, bottom: 0, top: 1, x: AXES.x, y: UNITS[0] };
  }

  /** @returns {boolean} a band of the deviation is drawn */
  get banded() {
    return this._restored.spread !== null;
  }

  /** @param {Plane} plane */
  use(plane) {
    this._plane = plane;
    this._raw = emptyLine(plane.raw, "raw");
    this._restored = emptyLine(plane.restored, "restored");
    this._lines = [this._raw, this._restored];
    this._deviation = emptyLine(plane.restored, "restored");
  }

  /**
   * @param {Frame|null} frame
   * @param {Marks} marks where the line and the probe are
   * @param {DisplayRange} range
   * @param {Float32Array|null} deviation of each restored cell; null where it is not known
   * @param {number} unit of pressure
   */
  draw(frame, marks, range, deviation, unit) {
    const plane = this._plane;
    if (!plane) return;
    const { along } = marks;
    const span = range.high - range.low;
    this._part.limit(plane.start(along), plane.start(along) + plane.extent(along));
    this._axes.left = this._part.left;
    this._axes.right = this._part.right;
    this._axes.x = AXES[along];
    this._axes.y = UNITS[unit];
    this._raw.length = this._restored.length = 0;
    if (frame) {
      sample(plane, plane.raw, frame.raw, marks, this._raw);
      sample(plane, plane.restored, frame.restored, marks, this._restored);
    }
    this._restored.spread = frame && deviation ? this._spread(plane, deviation, marks) : null;
    const highest = Math.max(highestIn(this._raw), highestIn(this._restored));
    this._axes.top = highest > range.high ? steadyTop(Math.max(this._axes.top, range.high), highest) : range.high;
    const floor = range.low - MARGIN * span;
    this._deep = goesBelow(this._raw, floor) || goesBelow(this._restored, floor) ? DEEP_FRAMES : Math.max(0, this._deep - 1);
    this._axes.bottom = range.low - (this._deep ? DEEP_MARGIN : MARGIN) * span;
    this._entitle(marks, frame ? marks.lineAt : NaN);
    const probe = along === "x" ? marks.probeX : marks.probeY;
    this.chart.draw(this._axes, this._lines, probe, Number.isFinite(probe) ? `${along} ${lengthText(probe)}` : "");
  }

  /** Say in the title where the line is that is drawn. @param {Marks} marks @param {number} at mm; NaN for nowhere */
  _entitle({ along, pinned }, at) {
    const titled = this._titled;
    if (titled.along === along && Object.is(titled.at, at) && titled.pinned === pinned) return;
    Object.assign(titled, { along, at, pinned });
    setText(byId("section-where"), Number.isFinite(at) ? `${ACROSS[along]} ${lengthText(at)}${pinned ? ", pinned" : ""}` : "");
  }

  /**
   * @param {Plane} plane
   * @param {Float32Array} deviation
   * @param {Marks} marks
   * @returns {Float64Array} half the height of the band
   */
  _spread(plane, deviation, marks) {
    sample(plane, plane.restored, deviation, marks, this._deviation);
    for (let i = 0; i < this._deviation.length; i += 1) this._deviation.y[i] *= BAND_DEVIATIONS;
    return this._deviation.y;
  }
}

/** @param {Line} of @param {number} floor @returns {boolean} some point is below */
function goesBelow(of, floor) {
  for (let i = 0; i < of.length; i += 1) if (of.y[i] < floor) return true;
  return false;
}

/** @param {Line} of @returns {number} its highest value; -Infinity where none is known */
function highestIn(of) {
  let highest = -Infinity;
  for (let i = 0; i < of.length; i += 1) if (of.y[i] > highest) highest = of.y[i];
  return highest;
}

/**
 * @param {Cells} cells
 * @param {"raw"|"restored"} ink
 * @returns {Line} with room for the cells along either axis
 */
const emptyLine = (cells, ink) =>
  line(Math.max(cells.rows, cells.columns), ink, cells.isRaster ? "steps" : "dots", cells.isRaster ? cells.side : 0);

/**
 * Lay the line through the probe, or the restored peak. It stays until the peak has clearly moved: noise alone must not
 * make it jump between equal rows.
 * @param {Plane} plane
 * @param {Marks} marks where it was
 * @param {{x: number, y: number}} probe mm, NaN for none
 * @param {Frame} frame
 * @returns {number} its place across, mm
 */
export function placeLine(plane, marks, probe, { ofRestored, restored }) {
  const across = ACROSS[marks.along];
  if (Number.isFinite(probe[across])) return probe[across];
  if (ofRestored.contact) {
    const stays = highestAlong(plane, marks, restored) >= LINE_STAYS * ofRestored.peak;
    return stays ? marks.lineAt : plane.restored[across][ofRestored.peakIndex];
  }
  return Number.isFinite(marks.lineAt) ? marks.lineAt : plane.start(across) + plane.extent(across) / 2;
}

/**
 * The largest pressure along a cross-section.
 * @param {Plane} plane
 * @param {Marks} marks where it is
 * @param {Float32Array} values of the restored image
 * @returns {number}
 */
export function highestAlong(plane, { along, lineAt }, values) {
  const cells = plane.restored;
  const across = cells[ACROSS[along]];
  const reach = cells.side / 2;
  let top = -Infinity;
  for (let i = 0; i < cells.count; i += 1) {
    if (values[i] > top && Math.abs(across[i] - lineAt) <= reach) top = values[i];
  }
  return top;
}

/**
 * @param {Plane} plane
 * @param {Cells} cells
 * @param {Float32Array} values
 * @param {Marks} marks
 * @param {Line} into
 */
export function sample(plane, cells, values, { along, lineAt }, into) {
  const places = cells[along];
  const across = cells[ACROSS[along]];
  let n = 0;
  if (cells.isRaster) {
    const { rows, columns, side } = cells;
    const upright = along === "y";
    const last = (upright ? columns : rows) - 1;
    const which = Math.max(0, Math.min(last, Math.floor((lineAt - plane.start(ACROSS[along])) / side)));
    const count = upright ? rows : columns;
    const step = upright ? columns : 1;
    for (let i = upright ? which : which * columns; n < count; i += step) {
      into.x[n] = places[i];
      into.y[n] = values[i];
      n += 1;
    }
  } else {
    for (const i of plane.order[along]) {
      if (Math.abs(across[i] - lineAt) > plane.pitch / 2) continue;
      into.x[n] = places[i];
      into.y[n] = values[i];
      n += 1;
    }
  }
  into.length = n;
}
