/** The maps as they are seen, with their legend and readings, as a PNG file. @module */

import { ABOVE, BELOW } from "../maps/colormap.js";
import { context2d, themeColors } from "../shell/dom.js";
import { hatching } from "../maps/heatmap.js";
import { AXIS_BOTTOM_PX, AXIS_LEFT_PX, drawAxes } from "../maps/map_axes.js";
import { endsAndTicks, tickText } from "../charts/ticks.js";
import { UNITS, forceText, lengthNumber, lengthText, pressureText } from "../shell/units.js";

/** @import { Colormap } from "../maps/colormap.js" */
/** @import { DisplayRange } from "../maps/display_range.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Plane } from "../maps/geometry.js" */
/** @import { Measures } from "../maps/measures.js" */
/** @import { Session } from "../wire/session.js" */
/** @import { ShearArrows } from "../maps/shear_arrows.js" */
/** @import { Viewer } from "../shell/viewer.js" */

/** @typedef {{title: string, right?: string, frames: HTMLElement[], of: Measures|null}} Shown a map; of two frames the first ends at the slider */

export const PICTURE_RATIO = 2; // pixels per px
const MAP_PX = 640; // px, a map's longer side
const MARGIN_PX = 32;
const TOP_PX = 84;
const BOTTOM_PX = 92;
const LINE_PX = 24; // of the text below
const LEGEND_PX = 96;
const MIN_TEXT_PX = 480; // px, width that the text below has at least
const MIN_LEGEND_PX = 220; // px, that the legend is tall at least
const TICK_GAP_PX = 44; // px between two of its ticks
const [TITLE_PX, TEXT_PX] = [19, 15]; // px, of letters

/**
 * Draw what is seen of the maps with their legend and readings; of 3-D surfaces the flat maps.
 * @param {Pick<Session, "name"|"plane">} session
 * @param {Frame} frame
 * @param {Pick<Viewer, "maps"|"view"|"range"|"shear">} viewer
 * @param {Colormap} colormap
 * @param {[string, string][]} origin name and value of what is said of the frame; the first two are its title
 * @param {number} [ratio] pixels per px
 * @returns {HTMLCanvasElement}
 */
export function picture({ name, plane }, frame, { maps, view, range, shear }, colormap, origin, ratio = PICTURE_RATIO) {
  const zoom = MAP_PX / Math.max(plane.width, plane.height);
  const w = Math.round(plane.width * zoom);
  const h = Math.round(plane.height * zoom);
  const title = `${name}, frame ${frame.sequence}`;
  const size = `map ${lengthNumber(plane.width)} × ${lengthText(plane.height)}, resolution ${lengthText(frame.resolutionMm)}`;
  const signed = view.name === "difference" ? view.signed : null;
  const shown = shownMaps(frame, maps, view.name);
  const below = shown.map(({ of, right }) => (of ? summaryLines(of, frame.unit, right) : [maps.extremes(plane, frame.unit)]));
  const column = Math.max(w, widest(["", ...below.flat()], TEXT_PX));
  const bodyHeight = Math.max(h, MIN_LEGEND_PX);
  const step = AXIS_LEFT_PX + column + MARGIN_PX; // from one map to the next
  const width = Math.max(shown.length * step + LEGEND_PX, widest([title], TITLE_PX), MIN_TEXT_PX);
  const said = origin.slice(2).map(([what, value]) => {
    if (what === "time" || what === "state") return value;
    return what.startsWith("warnings") ? `${what}: ${value}` : `${what} ${value}`;
  });
  const lines = wrap([...said, size].join(", "), width, TEXT_PX);
  const arrows = [maps.arrows, maps.restoredArrows].filter(({ canvas, empty }) =>
    shear && !empty && shown.some(({ frames }) => frames.some((each) => each.contains(canvas))));
  const height = TOP_PX + bodyHeight + AXIS_BOTTOM_PX + BOTTOM_PX + LINE_PX * (lines.length + arrows.length);
  const sheet = new Sheet(2 * MARGIN_PX + width, height, bodyHeight, ratio);
  sheet.write(title, MARGIN_PX, 32, TITLE_PX);
  const left = MARGIN_PX + AXIS_LEFT_PX;
  shown.forEach((each, i) => sheet.map(each, left + i * step, w, h, plane, view.cut, below[i]));
  const foot = TOP_PX + bodyHeight + AXIS_BOTTOM_PX + 84;
  lines.forEach((each, at) => sheet.write(each, MARGIN_PX, foot + LINE_PX * at, TEXT_PX, sheet.ink.muted));
  arrows.forEach((each, at) => sheet.arrow(each, MARGIN_PX, foot + LINE_PX * (lines.length + at), w));
  sheet.legend(left + shown.length * step - AXIS_LEFT_PX, signed ? maps.differenceRange : range, signed ?? colormap, frame.unit);
  return sheet.canvas;
}

/** @param {Frame} frame @param {Viewer["maps"]} maps @param {string} view @returns {Shown[]} */
function shownMaps(frame, maps, view) {
  const raw = { title: "Raw", frames: [maps.raw.frame], of: frame.ofRaw };
  const restored = { title: "Restored", frames: [maps.restored.frame], of: frame.ofRestored };
  if (view === "slider") return [{ title: "Raw", right: "Restored", frames: [maps.raw.frame, maps.restored.frame], of: frame.ofRestored }];
  if (view === "difference") return [{ title: "Restored − raw", frames: [maps.difference.frame], of: null }];
  return view === "raw" ? [raw] : view === "restored" ? [restored] : [raw, restored];
}

/** @param {Measures} of an image @param {number} unit of its pressure @param {string} [name] of the image, where its map shows another, too @returns {string[]} what stands below its map, line by line */
function summaryLines(of, unit, name) {
  const centre = `centre ${lengthNumber(of.x)}, ${lengthText(of.y)}`;
  return [`${name ? `${name}: ` : ""}force ${forceText(of.force, unit)}   peak ${pressureText(of.peak, unit)}`, centre];
}

/** @param {string[]} texts @param {number} size px, of their letters @returns {number} px, of the widest */
function widest(texts, size) {
  const draw = context2d(document.createElement("canvas"));
  draw.font = `${size}px ${themeColors().font}`;
  return Math.ceil(Math.max(...texts.map((each) => draw.measureText(each).width)));
}

/** @param {string} text @param {number} width px @param {number} size px, of its letters @returns {string[]} lines */
function wrap(text, width, size) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines[lines.length - 1]} ${word}`.trimStart();
    if (widest([longer], size) <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}

/** The picture while it is made. */
class Sheet {
  /** @param {number} width px @param {number} height px @param {number} bodyHeight px between head and foot @param {number} ratio pixels per px */
  constructor(width, height, bodyHeight, ratio) {
    this.canvas = document.createElement("canvas");
    this.canvas.width = ratio * width;
    this.canvas.height = ratio * height;
    this.ink = themeColors();
    this._tall = bodyHeight;
    this._pen = context2d(this.canvas);
    this._pen.scale(ratio, ratio);
    this._pen.fillStyle = this.ink.panel;
    this._pen.fillRect(0, 0, width, height);
  }

  /**
   * @param {string} text
   * @param {number} x
   * @param {number} y
   * @param {number} size px
   * @param {string} color
   */
  write(text, x, y, size = TEXT_PX, color = this.ink.text) {
    this._pen.font = `${size}px ${this.ink.font}`;
    this._pen.fillStyle = color;
    this._pen.fillText(text, x, y);
  }

  /**
   * @param {Shown} shown
   * @param {number} x
   * @param {number} w
   * @param {number} h
   * @param {Plane} plane
   * @param {number} cut share of the map at which the first of two frames ends
   * @param {string[]} below lines
   */
  map({ title, right, frames }, x, w, h, plane, cut, below) {
    const draw = this._pen;
    this.write(title, x, TOP_PX - 14, 16);
    if (right) this.write(right, x + w - widest([right], 16), TOP_PX - 14, 16);
    const [first, second] = frames;
    if (second) this._layers(second, x, w, h, plane.isGrid);
    draw.save();
    draw.beginPath();
    draw.rect(x, TOP_PX, second ? cut * w : w, h);
    draw.clip();
    this._layers(first, x, w, h, plane.isGrid);
    draw.restore();
    draw.fillStyle = "#fff";
    if (second) draw.fillRect(x + cut * w - 1, TOP_PX, 2, h);
    drawAxes(draw, plane, w / plane.width, x, TOP_PX, this.ink);
    below.forEach((each, at) => this.write(each, x, TOP_PX + h + AXIS_BOTTOM_PX + 28 + LINE_PX * at));
  }

  /**
   * Draw the cells of a map, and all that lies over them.
   * @param {HTMLElement} frame
   * @param {number} x
   * @param {number} w
   * @param {number} h
   * @param {boolean} grid
   */
  _layers(frame, x, w, h, grid) {
    const draw = this._pen;
    draw.fillStyle = grid ? hatching(draw) : "#333c46"; // where no data are
    draw.fillRect(x, TOP_PX, w, h);
    draw.imageSmoothingEnabled = !frame.classList.contains("raster");
    for (const each of frame.querySelectorAll(":scope > canvas")) {
      draw.drawImage(/** @type {HTMLCanvasElement} */ (each), x, TOP_PX, w, h);
      draw.imageSmoothingEnabled = true;
    }
  }

  /**
   * Tell how long an arrow is.
   * @param {ShearArrows} arrows
   * @param {number} x
   * @param {number} y
   * @param {number} w of the map
   */
  arrow(arrows, x, y, w) {
    const length = arrows.share * w;
    arrows.drawKey(this._pen, x + length / 2, y - 5, length, 1);
    this.write(`shear of ${arrows.text}`, x + length + 10, y, 15, this.ink.muted);
  }

  /** @param {number} x @param {DisplayRange} range @param {Colormap} colormap @param {number} unit */
  legend(x, range, colormap, unit) {
    const h = this._tall;
    this.write(UNITS[unit], x, TOP_PX - 14);
    for (let i = 0; i < 256; i += 1) {
      this._pen.fillStyle = colormap.css[i];
      this._pen.fillRect(x, TOP_PX + h * (1 - (i + 1) / 256), 20, h / 256 + 1);
    }
    for (const [color, y] of [[ABOVE, TOP_PX - 7], [BELOW, TOP_PX + h + 1]]) {
      this._pen.fillStyle = colormap.css[color];
      this._pen.fillRect(x, y, 20, 6);
    }
    const span = range.high - range.low;
    for (const value of endsAndTicks(range.low, range.high, h / TICK_GAP_PX)) {
      this.write(tickText(value, span), x + 28, TOP_PX + h * (1 - (value - range.low) / span) + 5);
    }
  }
}
