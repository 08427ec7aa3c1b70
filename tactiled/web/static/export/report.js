/** What is seen of one image as a page of its own: maps, values, contacts, regions and charts. @module */

import { number } from "../shell/format.js";
import { measureRegion } from "../maps/region_measure.js";
import { FORCE_UNITS, UNITS, forceNumber, lengthNumber } from "../shell/units.js";

/** @import { Frame, ForceTrace } from "../wire/frame_history.js" */
/** @import { Plane } from "../maps/geometry.js" */
/** @import { RegionMeasures } from "../maps/region_measure.js" */
/** @import { ThemeColors } from "../shell/dom.js" */
/** @import { Contact } from "../wire/sensor_stream.js" */

/** @typedef {{name: string, color: string, dash: string, isBand: boolean}} KeyEntry a line of a chart, named with its unit */
/** @typedef {{title: string, address: string, key: KeyEntry[]|null}} Picture null: it needs no caption */

/**
 * @typedef {object} Reported
 * @property {string} title
 * @property {Frame} frame
 * @property {Plane} plane
 * @property {[string, string][]} origin name and value of what is said of the frame
 * @property {Picture[]} pictures the maps first
 * @property {Contact[]|null} contacts null where they were not looked for in the frame
 * @property {[string, RegionMeasures|null][]} regions by name
 * @property {ForceTrace|null} trace of the force; null where it has none
 * @property {Pick<ThemeColors, "text"|"muted"|"panel">} colors of the page
 */

/** @param {Pick<ThemeColors, "text"|"muted"|"panel">} colors that the pictures have, too @returns {string} */
const styleOf = ({ text, muted, panel }) => `body { max-width: 1100px; margin: 24px auto; padding: 0 16px; color: ${text}; background: ${panel}; font: 15px/1.45 system-ui, sans-serif; }
.key { display: flex; flex-wrap: wrap; gap: 2px 18px; margin: 2px 0; padding: 0; list-style: none; } img { max-width: 100%; } figure { margin: 18px 0; } table { border-collapse: collapse; margin: 10px 0 18px; }
th, td { padding: 3px 14px 3px 0; text-align: right; font-variant-numeric: tabular-nums; } th:first-child, dt { text-align: left; color: ${muted}; font-weight: 400; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 2px 16px; } dd { margin: 0; }`;

/** @param {string} text @returns {string} for HTML */
const escaped = (text) => text.replace(/[&<>"]/g, (each) => `&#${each.charCodeAt(0)};`);

/** @param {string[][]} rows the first is the head @returns {string} */
const table = ([head, ...rows]) => `<table><thead><tr>${head.map((each) => (each ? `<th scope="col">${escaped(each)}</th>` : "<td></td>")).join("")}</tr></thead><tbody>${rows
  .map(([first, ...rest]) => `<tr><th scope="row">${escaped(first)}</th>${rest.map((each) => `<td>${escaped(each)}</td>`).join("")}</tr>`).join("")}</tbody></table>`;

/** @param {Reported} reported @returns {string} a page of HTML that needs no other file */
export function reportHtml({ title, frame, plane, origin, pictures, contacts, regions, trace, colors }) {
  const { unit, ofRaw, ofRestored } = frame;
  const [force, pressure] = [`, ${FORCE_UNITS[unit]}`, `, ${UNITS[unit]}`];
  const area = (/** @type {Float32Array} */ values, /** @type {number} */ gain, /** @type {import("../maps/geometry.js").Cells} */ cells) =>
    number(measureRegion([...cells.x.keys()].filter((i) => cells.area[i] && (values === frame.restored || values[i] === values[i])), { ...frame, restored: values, noiseGain: gain }, cells)?.area ?? NaN);
  const both = [
    ["", "raw", "restored"],
    [`force${force}`, forceNumber(ofRaw.force, unit), forceNumber(ofRestored.force, unit)],
    [`peak${pressure}`, number(ofRaw.peak), number(ofRestored.peak)],
    ["peak at x, mm", lengthNumber(ofRaw.peakX), lengthNumber(ofRestored.peakX)],
    ["peak at y, mm", lengthNumber(ofRaw.peakY), lengthNumber(ofRestored.peakY)],
    ["area, mm²", area(frame.raw, 1, plane.raw), area(frame.restored, frame.noiseGain, plane.restored)],
    ["centre x, mm", lengthNumber(ofRaw.x), lengthNumber(ofRestored.x)],
    ["centre y, mm", lengthNumber(ofRaw.y), lengthNumber(ofRestored.y)],
  ];
  const found = (contacts ?? []).map((each) => [
    `contact ${each.id}`, forceNumber(each.force, unit), number(each.peak), number(each.area_mm2), lengthNumber(each.x_mm), lengthNumber(each.y_mm),
  ]);
  const measured = regions.map(([name, of]) => [
    name, ...(of ? [forceNumber(of.force, unit), number(of.mean), number(of.peak), number(of.area)] : ["–", "–", "–", "–"]),
  ]);
  const sections = [
    `<dl>${origin.map(([name, value]) => `<dt>${escaped(name)}</dt><dd>${escaped(value)}</dd>`).join("")}</dl>`,
    ...pictures.slice(0, 1).map(figure), table(both),
    ...(found.length ? [`<h2>Contacts</h2>${table([["", `force${force}`, `peak${pressure}`, "area, mm²", "x, mm", "y, mm"], ...found])}`] : []),
    ...(contacts ? [] : ["<h2>Contacts</h2><p>They were not looked for in this frame.</p>"]),
    ...(measured.length ? [`<h2>Regions</h2>${table([["", `force${force}`, `mean${pressure}`, `peak${pressure}`, "area, mm²"], ...measured])}`] : []),
    ...pictures.slice(1).map(figure),
    ...(trace ? [`<details><summary>Force over time, values</summary><pre>${escaped(traceCsv(trace, FORCE_UNITS[unit]))}</pre></details>`] : []),
  ];
  return `<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>${escaped(title)}</title><style>${styleOf(colors)}</style></head>\n`
    + `<body><main><h1>${escaped(title)}</h1>\n${sections.join("\n")}\n</main></body></html>\n`;
}

/** @param {Picture} picture @returns {string} */
const figure = ({ title, address, key }) =>
  `<figure><img src="${address}" alt="${escaped(title)}">${key ? `<figcaption>${escaped(title)}<ul class="key">${key.map(entry).join("")}</ul></figcaption>` : ""}</figure>`;

/** @param {KeyEntry} entry @returns {string} */
const entry = ({ name, color, dash, isBand }) =>
  `<li><svg width="34" height="12" aria-hidden="true"><path d="M0 6H28" stroke="${color}" stroke-dasharray="${dash}" ${isBand ? 'stroke-width="10" opacity="0.35"' : 'stroke-width="3"'}/></svg>${escaped(name)}</li>`;

/** @param {ForceTrace} trace @param {string} unit @returns {string} */
function traceCsv(trace, unit) {
  const lines = [`time_s,raw_${unit},restored_${unit}`];
  for (let back = trace.length - 1; back >= 0; back -= 1) {
    const at = trace.place(back);
    const [raw, restored] = [trace.rawForces[at], trace.restoredForces[at]];
    if (!Number.isNaN(raw)) lines.push(`${trace.times[at].toFixed(3)},${+raw.toPrecision(6)},${Number.isNaN(restored) ? "" : +restored.toPrecision(6)}`);
  }
  return lines.join("\n");
}
