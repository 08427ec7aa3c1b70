/**
 * What is on the screen, as files.
 * @module
 */

import { fixed, inks, number, pen } from "./paint.js";
import { tickText, ticks } from "./scale.js";

/** @typedef {import("./plane.js").Plane} Plane */
/** @typedef {import("./plane.js").Cells} Cells */
/** @typedef {import("./history.js").Frame} Frame */
/** @typedef {import("./heatmap.js").Heatmap} Heatmap */
/** @typedef {import("./heatmap.js").Palette} Palette */
/** @typedef {import("./scale.js").Scale} Scale */

const MAP = 640; // px, a map's longer side
const EDGE = 32;
const HEAD = 84;
const FOOT = 84;
const LEGEND = 96;

/**
 * @param {string} name
 * @param {Blob} blob
 */
function download(name, blob) {
  const url = URL.createObjectURL(blob);
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/**
 * @param {string} sensor
 * @param {Frame} frame
 * @returns {string} a file's name without its ending
 */
const stem = (sensor, frame) => `${sensor.replace(/[^\w-]+/g, "_")}-${frame.sequence}`;

/**
 * @param {number} timestamp Unix s
 * @returns {string}
 */
const moment = (timestamp) => new Date(timestamp * 1000).toISOString();

/**
 * Save a frame, one line per cell.
 * @param {string} sensor
 * @param {Plane} plane
 * @param {Frame} frame
 * @param {string} method
 */
export function saveCsv(sensor, plane, frame, method) {
  const lines = [
    `# sensor ${sensor}, frame ${frame.sequence}, ${moment(frame.timestamp)}, method ${method}`,
    "# kpa is empty where nothing is known; flags: 1 missing, 2 bad, 4 dead, 8 saturated",
    "image,row,column,x_mm,y_mm,kpa,flags",
  ];
  rows("raw", plane.raw, frame.raw, frame.flags, lines);
  rows("restored", plane.restored, frame.restored, null, lines);
  download(`${stem(sensor, frame)}.csv`, new Blob([lines.join("\n"), "\n"], { type: "text/csv" }));
}

/**
 * @param {string} image
 * @param {Cells} cells
 * @param {Float32Array} kpa
 * @param {Uint8Array|null} flags
 * @param {string[]} into
 */
function rows(image, cells, kpa, flags, into) {
  for (let i = 0; i < cells.count; i += 1) {
    const row = Math.floor(i / cells.columns);
    const place = `${+cells.x[i].toFixed(4)},${+cells.y[i].toFixed(4)}`;
    const value = Number.isNaN(kpa[i]) ? "" : +kpa[i].toFixed(4);
    into.push(`${image},${row},${i % cells.columns},${place},${value},${flags ? flags[i] : ""}`);
  }
}

/**
 * Save both maps with their legend and readings.
 * @param {string} sensor
 * @param {Plane} plane
 * @param {Frame} frame
 * @param {Heatmap} raw
 * @param {Heatmap} restored
 * @param {Scale} scale
 * @param {Palette} palette
 * @param {string} state what the page says of the frame: live, stale, ...
 */
export function savePng(sensor, plane, frame, raw, restored, scale, palette, state) {
  const zoom = MAP / Math.max(plane.width, plane.height);
  const w = Math.round(plane.width * zoom);
  const h = Math.round(plane.height * zoom);
  const canvas = document.createElement("canvas");
  canvas.width = 3 * EDGE + 2 * w + LEGEND;
  canvas.height = HEAD + h + FOOT;
  const draw = pen(canvas);
  const ink = inks();
  draw.fillStyle = ink.panel;
  draw.fillRect(0, 0, canvas.width, canvas.height);
  const write = (/** @type {string} */ text, /** @type {number} */ x, /** @type {number} */ y, size = 15, color = ink.text) => {
    draw.font = `${size}px ${ink.font}`;
    draw.fillStyle = color;
    draw.fillText(text, x, y);
  };
  write(`${sensor}, frame ${frame.sequence}`, EDGE, 32, 19);
  write(`${moment(frame.timestamp)}, ${state}`, EDGE + 320, 32, 15, ink.muted);
  for (const [i, name, map, of] of /** @type {[number, string, Heatmap, import("./measures.js").Measures][]} */ ([
    [0, "Raw", raw, frame.ofRaw], [1, "Restored", restored, frame.ofRestored],
  ])) {
    const x = EDGE + i * (w + EDGE);
    write(name, x, HEAD - 14, 16);
    draw.fillStyle = "#8d949c";
    draw.fillRect(x, HEAD, w, h);
    if (!plane.isGrid) {
      draw.fillStyle = "#333c46";
      draw.fillRect(x, HEAD, w, h);
    }
    draw.imageSmoothingEnabled = !plane.isGrid;
    draw.drawImage(map.canvas, x, HEAD, w, h);
    draw.drawImage(map.overlay, x, HEAD, w, h);
    write(`force ${number(of.force)} N   peak ${number(of.peak)} kPa   centre ${fixed(of.x, 1)}, ${fixed(of.y, 1)} mm`, x, HEAD + h + 28);
  }
  write(`map ${fixed(plane.width, 1)} × ${fixed(plane.height, 1)} mm, resolution ${fixed(frame.resolutionMm, 2)} mm`, EDGE, HEAD + h + 56, 15, ink.muted);
  const x = 2 * w + 3 * EDGE;
  write("kPa", x, HEAD - 14);
  for (let i = 0; i < 256; i += 1) {
    draw.fillStyle = palette.css[i];
    draw.fillRect(x, HEAD + h * (1 - (i + 1) / 256), 20, h / 256 + 1);
  }
  const span = scale.high - scale.low;
  for (const value of ticks(scale.low, scale.high, 8)) {
    write(tickText(value, span), x + 28, HEAD + h * (1 - (value - scale.low) / span) + 5);
  }
  canvas.toBlob((blob) => blob && download(`${stem(sensor, frame)}.png`, blob), "image/png");
}
