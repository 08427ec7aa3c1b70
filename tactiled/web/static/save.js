/**
 * What is on the screen, as files.
 * @module
 */

import { fixed, inks, newtons, number, pen } from "./paint.js";
import { tickText, ticks } from "./scale.js";

/** @typedef {import("./plane.js").Cells} Cells */
/** @typedef {import("./history.js").Frame} Frame */
/** @typedef {import("./session.js").Session} Session */
/** @typedef {import("./maps.js").Maps} Maps */
/** @typedef {import("./heatmap.js").Palette} Palette */
/** @typedef {import("./scale.js").Scale} Scale */

const MAP = 640; // px, a map's longer side
const EDGE = 32;
const HEAD = 84;
const FOOT = 84;
const LEGEND = 96;
const NONE = new Float32Array(0);

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
 * @param {Session} session
 * @param {Frame} frame
 */
export function saveCsv({ name, plane }, frame) {
  const lines = [
    `# sensor ${name}, frame ${frame.sequence}, ${moment(frame.timestamp)}, method ${frame.ran}`,
    "# kpa is empty where nothing is known; flags: 1 missing, 2 bad, 4 dead, 8 saturated",
    `image,row,column,x_mm,y_mm,kpa,flags${frame.sheared ? ",shear_x_counts,shear_y_counts" : ""}`,
  ];
  rows("raw", plane.raw, frame.raw, frame.flags, frame.sheared ? frame.shear : null, lines);
  rows("restored", plane.restored, frame.restored, null, frame.sheared ? NONE : null, lines);
  download(`${stem(name, frame)}.csv`, new Blob([lines.join("\n"), "\n"], { type: "text/csv" }));
}

/**
 * @param {string} image
 * @param {Cells} cells
 * @param {Float32Array} kpa
 * @param {Uint8Array|null} flags
 * @param {Float32Array|null} shear counts along x of all, then along y; empty where it is of another image
 * @param {string[]} into
 */
function rows(image, cells, kpa, flags, shear, into) {
  for (let i = 0; i < cells.count; i += 1) {
    const row = Math.floor(i / cells.columns);
    const place = `${+cells.x[i].toFixed(4)},${+cells.y[i].toFixed(4)}`;
    const along = !shear ? "" : shear.length ? `,${plain(shear[i])},${plain(shear[cells.count + i])}` : ",,";
    into.push(`${image},${row},${i % cells.columns},${place},${plain(kpa[i])},${flags ? flags[i] : ""}${along}`);
  }
}

/**
 * @param {number} value
 * @returns {string} empty where nothing is known
 */
const plain = (value) => (Number.isNaN(value) ? "" : String(+value.toFixed(4)));

/**
 * Save both maps with their legend and readings.
 * @param {Session} session
 * @param {Frame} frame
 * @param {Maps} maps
 * @param {Scale} scale
 * @param {Palette} palette
 * @param {string} state what the page says of the frame: live, stale, ...
 * @param {boolean} shear whether it is shown
 */
export function savePng({ name, plane }, frame, maps, scale, palette, state, shear) {
  const zoom = MAP / Math.max(plane.width, plane.height);
  const w = Math.round(plane.width * zoom);
  const h = Math.round(plane.height * zoom);
  const canvas = document.createElement("canvas");
  canvas.width = 3 * EDGE + 2 * w + LEGEND;
  canvas.height = HEAD + h + FOOT;
  const sheet = new Sheet(canvas);
  sheet.write(`${name}, frame ${frame.sequence}`, EDGE, 32, 19);
  sheet.write(`${moment(frame.timestamp)}, ${state}`, EDGE + 320, 32, 15, sheet.ink.muted);
  const [raw, restored] = [[maps.rawMarks.canvas, maps.arrows.canvas], [maps.restoredMarks.canvas]];
  sheet.map("Raw", EDGE, w, h, maps.raw.canvas, raw, plane.isGrid, frame.ofRaw);
  sheet.map("Restored", w + 2 * EDGE, w, h, maps.restored.canvas, restored, plane.isGrid, frame.ofRestored);
  if (shear) sheet.arrow(maps.arrows, w + 2 * EDGE, HEAD + h + 56, w);
  const size = `map ${fixed(plane.width, 1)} × ${fixed(plane.height, 1)} mm, resolution ${fixed(frame.resolutionMm, 2)} mm`;
  sheet.write(size, EDGE, HEAD + h + 56, 15, sheet.ink.muted);
  sheet.legend(2 * w + 3 * EDGE, h, scale, palette);
  canvas.toBlob((blob) => blob && download(`${stem(name, frame)}.png`, blob), "image/png");
}

/** The picture while it is made. */
class Sheet {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.ink = inks();
    this._pen = pen(canvas);
    this._pen.fillStyle = this.ink.panel;
    this._pen.fillRect(0, 0, canvas.width, canvas.height);
  }

  /**
   * @param {string} text
   * @param {number} x
   * @param {number} y
   * @param {number} size px
   * @param {string} color
   */
  write(text, x, y, size = 15, color = this.ink.text) {
    this._pen.font = `${size}px ${this.ink.font}`;
    this._pen.fillStyle = color;
    this._pen.fillText(text, x, y);
  }

  /**
   * @param {string} title
   * @param {number} x
   * @param {number} w
   * @param {number} h
   * @param {HTMLCanvasElement} cells
   * @param {HTMLCanvasElement[]} marks
   * @param {boolean} grid
   * @param {import("./measures.js").Measures} of
   */
  map(title, x, w, h, cells, marks, grid, of) {
    const draw = this._pen;
    this.write(title, x, HEAD - 14, 16);
    draw.fillStyle = grid ? "#8d949c" : "#333c46";
    draw.fillRect(x, HEAD, w, h);
    draw.imageSmoothingEnabled = !grid;
    draw.drawImage(cells, x, HEAD, w, h);
    draw.imageSmoothingEnabled = true;
    for (const each of marks) draw.drawImage(each, x, HEAD, w, h);
    const centre = `centre ${fixed(of.x, 1)}, ${fixed(of.y, 1)} mm`;
    this.write(`force ${newtons(of.force)} N   peak ${number(of.peak)} kPa   ${centre}`, x, HEAD + h + 28);
  }

  /**
   * Tell how long an arrow is.
   * @param {import("./shear.js").Arrows} arrows
   * @param {number} x
   * @param {number} y
   * @param {number} w of the map
   */
  arrow(arrows, x, y, w) {
    const length = arrows.share * w;
    arrows.drawKey(this._pen, x + length / 2, y - 5, length, 1);
    this.write(`shear of ${arrows.full} counts`, x + length + 10, y, 15, this.ink.muted);
  }

  /**
   * @param {number} x
   * @param {number} h
   * @param {Scale} scale
   * @param {Palette} palette
   */
  legend(x, h, scale, palette) {
    this.write("kPa", x, HEAD - 14);
    for (let i = 0; i < 256; i += 1) {
      this._pen.fillStyle = palette.css[i];
      this._pen.fillRect(x, HEAD + h * (1 - (i + 1) / 256), 20, h / 256 + 1);
    }
    const span = scale.high - scale.low;
    for (const value of ticks(scale.low, scale.high, 8)) {
      this.write(tickText(value, span), x + 28, HEAD + h * (1 - (value - scale.low) / span) + 5);
    }
  }
}
