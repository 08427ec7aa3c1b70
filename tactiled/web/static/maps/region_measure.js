/** What a region holds in the frame that is shown, as the service measures it. @module */

import { FORCE_SCALES } from "../shell/units.js";

/** @import { Shape } from "../wire/api.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Cells } from "./geometry.js" */

const CONTACT_DEVIATIONS = 3; // of the noise above which a cell is in contact

/** @typedef {{force: number, mean: number, peak: number, area: number}} RegionMeasures */

/** @param {{shape: Shape, points_mm: [number, number][]}} region @param {Cells} cells @returns {number[]} those that taxels feel and whose centres lie in it */
export function cellsIn({ shape, points_mm: points }, { x, y, area, count }) {
  const inside = shape === "polygon" ? inPolygon : inBox;
  return Array.from({ length: count }, (_, i) => i).filter((i) => area[i] && inside(points, x[i], y[i], shape === "ellipse"));
}

/** @param {[number, number][]} points @param {number} x @param {number} y @param {boolean} round @returns {boolean} */
function inBox([[x0, y0], [x1, y1]], x, y, round) {
  const across = Math.abs(x - (x0 + x1) / 2) / (Math.abs(x1 - x0) / 2 || 1e-9);
  const down = Math.abs(y - (y0 + y1) / 2) / (Math.abs(y1 - y0) / 2 || 1e-9);
  return round ? across ** 2 + down ** 2 <= 1 : Math.max(across, down) <= 1;
}

/** @param {[number, number][]} points @param {number} x @param {number} y @returns {boolean} */
function inPolygon(points, x, y) {
  let inside = false;
  for (let i = 0, last = points.length - 1; i < points.length; last = i, i += 1) {
    const [ax, ay] = points[i];
    const [bx, by] = points[last];
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) inside = !inside;
  }
  return inside;
}

/** @param {number[]} region cells @param {Frame} frame @param {Cells} cells @returns {RegionMeasures|null} null where a cell is unknown; of the highest of each cell, which were never there together, the peak alone */
export function measureRegion(region, { restored, noise, noiseGain, unit, highest }, { area }) {
  const clear = CONTACT_DEVIATIONS * (noise || 0) * Math.max(1, noiseGain || 0);
  if (!region.length || region.some((i) => restored[i] !== restored[i])) return null;
  let [sum, size, peak, pressed] = [0, 0, -Infinity, 0];
  for (const i of region) {
    sum += restored[i] * area[i];
    size += area[i];
    peak = Math.max(peak, restored[i]);
    if (restored[i] > clear) pressed += area[i];
  }
  if (highest) return { force: NaN, mean: NaN, peak, area: NaN };
  return { force: sum * FORCE_SCALES[unit], mean: sum / size, peak, area: pressed };
}
