/** A frame or series as CSV: comments that begin with #, then one line per cell or time. @module */

import { UNITS } from "../shell/units.js";

/** @import { Quantity, Series } from "../wire/api.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Cells, Plane } from "../maps/geometry.js" */

/**
 * @param {Plane} plane
 * @param {Frame} frame
 * @param {[string, string][]} origin name and value of what else is to be said of the frame
 * @returns {string}
 */
export function csvText(plane, frame, origin) {
  const { sheared, shear, traction } = frame;
  const count = plane.restored.count;
  const dragged = sheared && traction.length > 0;
  const pressure = UNITS[frame.unit].toLowerCase();
  const lines = [
    ...origin.map(([name, value]) => `# ${name}: ${value}`),
    `# pitch_mm: ${plane.pitch}`,
    `# ${pressure} is empty where there is no data; flags: 1 missing, 2 bad, 4 dead, 8 saturated, 16 out of range, 32 faulty, 64 far below zero`,
    `image,row,column,x_mm,y_mm,${pressure},flags${sheared ? ",shear_x_counts,shear_y_counts" : ""}${dragged ? ",shear_x_kpa,shear_y_kpa" : ""}`,
  ];
  for (let i = 0; i < plane.raw.count; i += 1) {
    const shears = sheared ? `,${decimal(shear[i])},${decimal(shear[plane.raw.count + i])}` : "";
    lines.push(`raw,${place(plane.raw, i)},${decimal(frame.raw[i])},${frame.flags[i]}${shears}${dragged ? ",," : ""}`);
  }
  for (let i = 0; i < count; i += 1) {
    const loads = dragged ? `,${decimal(traction[i])},${decimal(traction[count + i])}` : "";
    if (plane.restored.area[i]) lines.push(`restored,${place(plane.restored, i)},${decimal(frame.restored[i])},${sheared ? ",," : ""}${loads}`);
  }
  return `${lines.join("\n")}\n`;
}

/**
 * @param {Map<string, Series>} all by kind and name, as "contact 3"
 * @param {number} unit of their pressure
 * @param {[string, string][]} origin name and value of what else is to be said of them
 * @returns {string}
 */
export function seriesCsv(all, unit, origin) {
  const quantities = /** @type {Quantity[]} */ (["force", "mean", "peak", "area", "x", "y"]);
  const force = ["N", "counts_mm2"][unit];
  const lines = [
    ...origin.filter(([name]) => name !== "unit").map(([name, value]) => `# ${name}: ${value}`), // columns have theirs
    "# time_s is Unix time; the mean of a contact is its force over its area, x_mm and y_mm are its centre of pressure",
    `time_s,kind,name,force_${force},mean_${UNITS[unit]},peak_${UNITS[unit]},area_mm2,x_mm,y_mm`,
  ];
  for (const [key, series] of all) {
    series.time.forEach((time, i) => {
      const row = quantities.map((each) => series[each]?.[i] ?? NaN);
      if (row.some((each) => !Number.isNaN(each))) lines.push([time.toFixed(6), key.replace(" ", ","), ...row.map((each) => (Number.isNaN(each) ? "" : +each.toPrecision(6)))].join());
    });
  }
  return `${lines.join("\n")}\n`;
}

/** @param {Cells} cells @param {number} i */
const place = ({ columns, x, y }, i) => `${Math.floor(i / columns)},${i % columns},${decimal(x[i])},${decimal(y[i])}`;

/** @param {number} value @returns {string} empty without data */
const decimal = (value) => (Number.isNaN(value) ? "" : String(+value.toFixed(4)));
