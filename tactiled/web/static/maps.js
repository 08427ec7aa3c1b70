/** The raw and the restored map side by side, on one colour scale and one scale in mm. @module */

import { Colorbar } from "./colorbar.js";
import { byId, setText } from "./dom.js";
import { Heatmap } from "./heatmap.js";
import { Overlay } from "./overlay.js";
import { ShearArrows } from "./shear_arrows.js";

/** @import { Colormap } from "./colormap.js" */
/** @import { DisplayRange } from "./display_range.js" */
/** @import { Frame } from "./frame_history.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { Marks } from "./overlay.js" */

const WIDE_WINDOW = matchMedia("(min-width: 900px)"); // where the maps share the window's height
const LONG_RATIO = 1.5; // times the height, from which width a map on a phone has the page's whole width
const MIN_SNAP_SHARE = 0.94; // of the size there is, from which a cell is made a whole number of pixels

export class Maps {
  constructor() {
    this.raw = new Heatmap(byId("raw"), byId("raw-frame"));
    this.restored = new Heatmap(byId("restored"), byId("restored-frame"));
    this.rawMarks = new Overlay(byId("raw-marks"));
    this.restoredMarks = new Overlay(byId("restored-marks"));
    this.arrows = new ShearArrows(byId("raw-shear"), byId("shear-key"));
    this.colorbar = new Colorbar(byId("colorbar"));
    this._boxes = byId("boxes");
    /** @type {Plane|null} */
    this._plane = null;
  }

  /** @param {Plane} plane */
  use(plane) {
    this._plane = plane;
    this.raw.use(plane, plane.raw);
    this.restored.use(plane, plane.restored);
    this.layout();
  }

  /** Show nothing. */
  clear() {
    this._plane = null;
    for (const each of [this.raw, this.restored, this.rawMarks, this.restoredMarks]) each.clear();
    this.arrows.reset();
    this.colorbar.clear();
  }

  /**
   * @param {Frame} frame
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @param {Marks} marks
   * @param {boolean} shear whether it is shown
   */
  paint(frame, range, colormap, marks, shear) {
    this.raw.paint(frame.raw, range, colormap);
    this.restored.paint(frame.restored, range, colormap);
    const flags = frame.saturated ? frame.flags : null;
    this.rawMarks.draw(marks, frame.ofRaw, flags);
    this.restoredMarks.draw(marks, frame.ofRestored, flags);
    if (shear && frame.sheared) this.arrows.draw(frame.shear, frame.timestamp);
    else this.arrows.clear();
  }

  /**
   * @param {Plane} plane
   * @param {HTMLElement} box of a map
   * @returns {number} height beyond which the maps would fill no more, CSS px
   */
  _maxHeight(plane, box) {
    const map = (plane.height * box.clientWidth) / plane.width;
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
    const beside = Math.min((width - gap) / 2 / plane.width, (height - caption) / plane.height);
    const above = Math.min(width / plane.width, ((height - gap) / 2 - caption) / plane.height);
    return above > beside;
  }

  /** Make both maps as large as their boxes allow, true to scale. */
  layout() {
    const plane = this._plane;
    if (!plane) return;
    const box = /** @type {HTMLElement} */ (this.raw.frame.parentElement);
    const maps = byId("maps");
    maps.style.removeProperty("--most"); // to see what room there is
    this._boxes.classList.toggle("stacked", WIDE_WINDOW.matches ? this._largerStacked(plane, box) : plane.width > LONG_RATIO * plane.height);
    maps.style.setProperty("--most", `${this._maxHeight(plane, box)}px`);
    const height = WIDE_WINDOW.matches ? box.clientHeight : 0.7 * window.innerHeight;
    const zoom = snapZoom(plane, Math.min(box.clientWidth / plane.width, height / plane.height));
    this.raw.resize(zoom);
    this.restored.resize(zoom);
    this.rawMarks.resize(plane, zoom);
    this.restoredMarks.resize(plane, zoom);
    this.arrows.resize(plane, zoom);
    const length = roundDown((0.22 * box.clientWidth) / zoom);
    byId("ruler-bar").style.width = `${length * zoom}px`;
    setText(byId("ruler-text"), `${length} mm`);
    const apart = this.restored.frame.getBoundingClientRect().top - this.raw.frame.getBoundingClientRect().top;
    byId("legend").style.setProperty("--map-height", `${apart + plane.height * zoom}px`);
    this.colorbar.forget();
  }
}

/**
 * @param {Plane} plane
 * @param {number} zoom CSS px per mm
 * @returns {number} a little less, where that puts the cells of a grid on whole pixels
 */
function snapZoom(plane, zoom) {
  if (!plane.isGrid) return zoom;
  const cell = Math.min(plane.raw.side, plane.restored.side);
  const ratio = window.devicePixelRatio || 1;
  const snapped = Math.floor(zoom * cell * ratio) / ratio / cell;
  return snapped > MIN_SNAP_SHARE * zoom ? snapped : zoom;
}

/** @param {number} length @returns {number} a round number not above it */
function roundDown(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return ([5, 2, 1].find((step) => step * power <= length) ?? 1) * power;
}
