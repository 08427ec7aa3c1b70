/** The raw and the restored map side by side, on one colour scale and one scale in mm. @module */

import { CellValues } from "./cell_values.js";
import { CentrePath } from "./centre_path.js";
import { Colorbar } from "./colorbar.js";
import { byId, setText } from "../shell/dom.js";
import { DisplayRange } from "./display_range.js";
import { number } from "../shell/format.js";
import { Heatmap } from "./heatmap.js";
import { AXIS_BOTTOM_PX, AXIS_LEFT_PX, MapAxes } from "./map_axes.js";
import { Overlay } from "./overlay.js";
import { Projection } from "./projection.js";
import { ON_COVER, SENSED, ShearArrows } from "./shear_arrows.js";
import { Surface } from "./surface.js";
import { UNITS, lengthNumber } from "../shell/units.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { Frame, FrameHistory } from "../wire/frame_history.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { Marks } from "./overlay.js" */
/** @import { View } from "../shell/view.js" */

const WIDE_WINDOW = matchMedia("(min-width: 900px)"); // where the maps share the window's height
const LONG_RATIO = 1.5; // times the height, from which width a map on a phone has the page's whole width
const MIN_BESIDE_PX = 600; // CSS px, of both surfaces side by side on a page of one column
const MIN_SNAP_SHARE = 0.94; // of the size there is, from which a cell is made a whole number of pixels

export class Maps {
  /** @param {() => void} onTurn the surfaces were turned */
  constructor(onTurn) {
    this.raw = new Heatmap(byId("raw"), byId("raw-frame"));
    this.restored = new Heatmap(byId("restored"), byId("restored-frame"));
    this.rawMarks = new Overlay(byId("raw-marks"));
    this.restoredMarks = new Overlay(byId("restored-marks"));
    this._differenceMarks = new Overlay(byId("difference-marks"));
    this._marks = [this.rawMarks, this.restoredMarks, this._differenceMarks];
    this.arrows = new ShearArrows(byId("raw-shear"), byId("shear-key"), SENSED);
    this.restoredArrows = new ShearArrows(byId("restored-shear"), byId("traction-key"), ON_COVER);
    this.colorbar = new Colorbar(byId("colorbar"));
    /** Restored less raw, by cell of the restored map. */
    this.difference = new Heatmap(byId("difference"), byId("difference-frame"));
    this._maps = [this.raw, this.restored, this.difference];
    this._paths = [new CentrePath(this.raw.frame, "ofRaw"), new CentrePath(this.restored.frame, "ofRestored")];
    this._values = this._maps.map((each) => new CellValues(each.canvas));
    this._axes = this._maps.map((each) => new MapAxes(each.frame));
    this._differenceRange = new DisplayRange();
    this._differenceColorbar = new Colorbar(byId("difference-colorbar"));
    this._differences = new Float32Array(0);
    this._taxels = new Int32Array(0); // that the cells of the restored map lie on
    this._boxes = byId("boxes");
    /** Of both surfaces. */
    this.projection = new Projection();
    const turned = () => {
      for (const each of this._surfaces) each.aim();
      onTurn();
    };
    this._surfaces = [new Surface("Raw", this.raw.frame, this.projection, turned), new Surface("Restored", this.restored.frame, this.projection, turned)];
    byId("surface-reset").addEventListener("click", () => {
      this.projection.reset();
      turned();
    });
    /** CSS px per mm. */
    this.zoom = 1;
    /** @type {Plane|null} */
    this._plane = null;
  }

  /** @param {Plane} plane */
  use(plane) {
    this._plane = plane;
    this.raw.use(plane, plane.raw);
    this.restored.use(plane, plane.restored);
    this.difference.use(plane, plane.restored);
    const { x, y, count } = plane.restored;
    this._taxels = Int32Array.from({ length: count }, (_, i) => plane.find(plane.raw, x[i], y[i]));
    this._surfaces[0].use(plane, plane.raw, this._taxels);
    this._surfaces[1].use(plane, plane.restored, this._taxels);
    this._differences = new Float32Array(count);
    this._differenceRange.reset();
    this.layout();
  }

  /** Show nothing. */
  clear() {
    this._plane = null;
    for (const each of [...this._maps, ...this._values, ...this._surfaces, ...this._paths, ...this._marks]) each.clear();
    this.arrows.reset();
    this.restoredArrows.reset();
    this.colorbar.clear();
    this._differenceColorbar.clear();
  }

  /**
   * @param {Frame} frame
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @param {Marks} marks
   * @param {boolean} shear whether it is shown
   * @param {View} view
   */
  paint(frame, range, colormap, marks, shear, view) {
    this.raw.paint(frame.raw, range, colormap);
    this.restored.paint(frame.restored, range, colormap);
    const flags = frame.saturated ? frame.flags : null;
    this.rawMarks.draw(marks, frame.ofRaw, flags);
    this.restoredMarks.draw(marks, frame.ofRestored, flags);
    if (shear && frame.sheared) this.arrows.draw(frame.shear, frame.timestamp);
    else this.arrows.clear();
    if (shear && frame.sheared && frame.traction.length) this.restoredArrows.draw(frame.traction, frame.timestamp);
    else this.restoredArrows.clear();
    if (view.name === "difference" && view.signed) {
      this._paintDifference(frame, range, view.signed);
      this._differenceMarks.draw(marks, frame.ofRestored, flags);
    }
    this._writeValues(frame, range, colormap, view);
    if (view.name !== "surface") return;
    this._surfaces[0].paint(frame.raw, range, colormap, frame.unit);
    this._surfaces[1].paint(frame.restored, range, colormap, frame.unit);
  }

  /** @param {FrameHistory|null} history null: no path @param {number} back which frame is shown @param {Plane} plane */
  drawPath(history, back, plane) {
    for (const each of this._paths) {
      if (history) each.draw(history, back, plane);
      else each.clear();
    }
  }

  /**
   * Write values in the cells, if they are large enough.
   * @param {Frame} frame
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @param {View} view
   */
  _writeValues(frame, range, colormap, { name, signed }) {
    const plane = this._plane;
    if (!plane || name === "surface") return;
    const [raw, restored, difference] = this._values;
    if (name === "difference") {
      if (signed) difference.draw(this._differences, plane, plane.restored, this._differenceRange, signed, this._differenceMarks);
      return;
    }
    raw.draw(frame.raw, plane, plane.raw, range, colormap, this.rawMarks);
    restored.draw(frame.restored, plane, plane.restored, range, colormap, this.restoredMarks);
  }

  /** Write the extremes of the difference; seldom, as nobody reads sixty a second. @param {Frame} frame @param {View} view */
  write(frame, { name, signed }) {
    if (this._plane && name === "difference" && signed) setText(byId("difference-extremes"), `: ${this.extremes(this._plane, frame.unit)}`);
  }

  /** @param {Plane} plane @param {number} unit @returns {string} the extremes of the difference that is shown */
  extremes({ restored: { x, y } }, unit) {
    const [lowest, highest] = extremes(this._differences);
    const [low, high] = [lowest, highest].map((i) => (i < 0 ? 0 : this._differences[i]));
    const place = highest < 0 ? "" : ` at x ${lengthNumber(x[highest])}, y ${lengthNumber(y[highest])} mm`;
    return `${signedText(low)} to ${signedText(high)} ${UNITS[unit]}${place}`;
  }

  /** @returns {DisplayRange} of the difference */
  get differenceRange() {
    return this._differenceRange;
  }

  /** @param {Frame} frame @param {DisplayRange} shared of both maps: where it is fixed, so is that of the difference @param {Colormap} colormap */
  _paintDifference({ raw, restored, noise, timestamp, unit }, shared, colormap) {
    const { _differences: values, _differenceRange: range } = this;
    let peak = 0;
    for (let i = 0; i < values.length; i += 1) {
      const value = (values[i] = restored[i] - raw[this._taxels[i]]);
      if (Math.abs(value) > peak) peak = Math.abs(value);
    }
    range.follow(peak, noise, timestamp);
    if (!shared.auto) range.high = Math.max(Math.abs(shared.low), Math.abs(shared.high));
    range.low = -range.high;
    this.difference.paint(values, range, colormap);
    this._differenceColorbar.draw(range, colormap, unit);
  }

  /**
   * @param {Plane} plane
   * @param {HTMLElement} box of a map
   * @returns {number} height beyond which the maps would fill no more, CSS px
   */
  _maxHeight(plane, box) {
    const map = (plane.height * (box.clientWidth - AXIS_LEFT_PX)) / plane.width + AXIS_BOTTOM_PX;
    const around = this._boxes.clientHeight - box.clientHeight; // the captions, and the other map where it is below
    const other = this._boxes.classList.contains("stacked") ? map - box.clientHeight : 0;
    return Math.ceil(map + other + around);
  }

  /**
   * @param {Plane} plane
   * @param {HTMLElement} box of a map
   * @returns {boolean} one above the other, the maps are larger than side by side
   */
  _largerStacked(plane, box) {
    const gap = parseFloat(getComputedStyle(this._boxes).columnGap);
    const caption = box.offsetTop - /** @type {HTMLElement} */ (box.parentElement).offsetTop;
    const width = this._boxes.clientWidth;
    const height = Math.min(this._boxes.clientHeight, window.innerHeight);
    const beside = Math.min(((width - gap) / 2 - AXIS_LEFT_PX) / plane.width, (height - caption - AXIS_BOTTOM_PX) / plane.height);
    const above = Math.min((width - AXIS_LEFT_PX) / plane.width, ((height - gap) / 2 - caption - AXIS_BOTTOM_PX) / plane.height);
    return above > beside;
  }

  /** Make both maps as large as their boxes allow, true to scale. */
  layout() {
    const plane = this._plane;
    if (!plane) return;
    const shown = this._maps.find((each) => each.frame.offsetParent) ?? this.restored;
    const box = /** @type {HTMLElement} */ (shown.frame.parentElement);
    const maps = byId("maps");
    const main = byId("main");
    const single = main.classList.contains("single");
    const surface = maps.dataset.view === "surface";
    main.style.removeProperty("--most"); // to see what room there is
    let stacked = WIDE_WINDOW.matches ? this._largerStacked(plane, box) : plane.width > LONG_RATIO * plane.height;
    if (surface) stacked = !WIDE_WINDOW.matches && this._boxes.clientWidth < MIN_BESIDE_PX;
    this._boxes.classList.toggle("stacked", stacked && !single);
    if (!surface) main.style.setProperty("--most", `${this._maxHeight(plane, box)}px`);
    const height = WIDE_WINDOW.matches ? box.clientHeight - AXIS_BOTTOM_PX : 0.7 * window.innerHeight;
    const zoom = snapZoom(plane, Math.min((box.clientWidth - AXIS_LEFT_PX) / plane.width, height / plane.height));
    this.zoom = zoom;
    for (const each of this._maps) each.resize(zoom);
    for (const each of this._values) each.resize(plane, zoom);
    for (const each of this._axes) each.draw(plane, zoom);
    for (const each of this._paths) each.resize(plane, zoom);
    for (const each of this._marks) each.resize(plane, zoom);
    this.arrows.resize(plane, zoom);
    this.restoredArrows.resize(plane, zoom);
    const tops = this._maps.filter((each) => each.frame.offsetParent).map((each) => each.frame.getBoundingClientRect().top);
    const mapHeight = surface ? box.clientHeight - AXIS_BOTTOM_PX : Math.max(...tops) - Math.min(...tops) + plane.height * zoom;
    maps.style.setProperty("--map-height", `${mapHeight}px`);
    maps.style.setProperty("--map-width", `${plane.width * zoom}px`);
    if (surface) {
      this.projection.fit(plane, box.clientWidth, box.clientHeight);
      for (const each of this._surfaces) each.resize(box.clientWidth, box.clientHeight);
    }
    this.colorbar.forget();
    this._differenceColorbar.forget();
  }
}

/** @param {Float32Array} values @returns {[number, number]} indices of the lowest below zero and of the highest above it; -1 for none */
function extremes(values) {
  let lowest = -1;
  let highest = -1;
  for (let i = 0; i < values.length; i += 1) {
    if (values[i] < (values[lowest] ?? 0)) lowest = i;
    if (values[i] > (values[highest] ?? 0)) highest = i;
  }
  return [lowest, highest];
}

/** @param {number} value @returns {string} */
const signedText = (value) => `${value > 0 ? "+" : ""}${number(value)}`;

/**
 * @param {Plane} plane
 * @param {number} zoom CSS px per mm
 * @returns {number} a little less, where that puts the cells on whole pixels
 */
function snapZoom(plane, zoom) {
  const cell = plane.restored.side;
  const ratio = window.devicePixelRatio || 1;
  const snapped = Math.floor(zoom * cell * ratio) / ratio / cell;
  return snapped > MIN_SNAP_SHARE * zoom ? snapped : zoom;
}
