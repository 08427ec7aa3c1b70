/** How the maps are shown: side by side or compared, in which colours, on which range. The page's address keeps it. @module */

import * as api from "../wire/api.js";
import { Colormap } from "../maps/colormap.js";
import { byId } from "./dom.js";
import { messageOf, notice } from "./notice.js";
import { loadSetting, saveSetting } from "./storage.js";
import { isDark } from "./theme.js";

/** @import { DisplayRange } from "../maps/display_range.js" */
/** @import { Projection } from "../maps/projection.js" */

const KEY = "tactiled.colors";
const SCALE_KEY = "tactiled.scale";
const SINGLE = new Set(["slider", "raw", "restored", "difference"]); // views of one map
const DIFFERENCE_COLORS = "RdBu_r"; // blue below zero, red above, told apart by the colour-blind
/** @type {[number, number, number][]} the same from blue by black to red, for a dark page */
const DARK_DIFFERENCES = Array.from({ length: 256 }, (_, i) => {
  const share = (i - 127.5) / 127.5;
  const end = share < 0 ? [90, 179, 255] : [255, 128, 96];
  return /** @type {[number, number, number]} */ (end.map((each) => Math.round(16 + (each - 16) * Math.abs(share) ** 0.8)));
});

/** What the address says behind a sensor's name. @returns {URLSearchParams} */
function inAddress() {
  return new URLSearchParams(location.hash.split("?")[1] ?? "");
}

export class View {
  /**
   * @param {DisplayRange[]} ranges by unit of pressure
   * @param {Projection} projection of the 3-D surfaces
   * @param {() => void} onChange
   */
  constructor(ranges, projection, onChange) {
    this._ranges = ranges;
    this._projection = projection;
    this._onChange = onChange;
    this._views = /** @type {HTMLSelectElement} */ (byId("view"));
    this._colors = /** @type {HTMLSelectElement} */ (byId("colors"));
    this._scales = /** @type {HTMLSelectElement} */ (byId("wall-scale"));
    this._split = /** @type {HTMLInputElement} */ (byId("split"));
    /** @type {Colormap|null} */
    this.colormap = null;
    /** @type {Colormap|null} of differences on a light page */
    this._signed = null;
    this._darkSigned = new Colormap(DARK_DIFFERENCES, true);
    this._views.addEventListener("change", () => {
      this._show();
      onChange();
    });
    this._colors.addEventListener("change", () => this._recolor());
    this._split.addEventListener("input", () => this._cut());
    const handle = byId("split-handle");
    handle.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      handle.setPointerCapture(event.pointerId);
    });
    handle.addEventListener("pointermove", ({ clientX, pointerId }) => {
      if (!handle.hasPointerCapture(pointerId)) return;
      const { left, width } = byId("restored-frame").getBoundingClientRect();
      this._split.value = String((100 * (clientX - left)) / width);
      this._cut();
    });
    const given = inAddress();
    pick(this._views, given.get("view"));
    pick(this._colors, given.get("colors") ?? loadSetting(KEY));
    pick(this._scales, given.get("scale") ?? loadSetting(SCALE_KEY));
    this._scales.addEventListener("change", () => saveSetting(SCALE_KEY, this._scales.value));
    /** @type {string[]} ends of the range in the address, in the unit of the sensor that it names */
    this._rangeInAddress = (given.get("range") ?? "").split(":");
    const [azimuth, elevation] = (given.get("turn") ?? "").split(":").map(Number);
    if (Number.isFinite(azimuth) && Number.isFinite(elevation)) projection.aim(azimuth, elevation);
    this._cut();
    this._show();
  }

  /** @returns {number} where raw ends on the slider, as a share of the map */
  get cut() {
    return Number(this._split.value) / 100;
  }

  /** @returns {Colormap|null} of differences */
  get signed() {
    return this._signed && isDark() ? this._darkSigned : this._signed;
  }

  /** @returns {string} both, slider, raw, restored, difference or surface */
  get name() {
    return this._views.value;
  }

  /** Fix the range that the address has, once it is known of which unit it is. @param {number} unit */
  fixRange(unit) {
    const [low, high] = this._rangeInAddress.map(Number);
    this._ranges[unit].fix(low, high); // which refuses what is no range
    this._rangeInAddress = [];
  }

  /** @returns {boolean} each map of the wall has a scale of its own */
  get ownScales() {
    return this._scales.value === "own";
  }

  /** @returns {string} what the wall's address says of its scales; "" for nothing */
  get wallAddress() {
    return this._scales.selectedIndex ? `?scale=${this._scales.value}` : "";
  }

  /** @param {number} unit of the sensor that is watched @returns {string} what an address says of the view; "" for nothing */
  address(unit) {
    const range = this._ranges[unit];
    const said = new URLSearchParams();
    if (this._views.selectedIndex) said.set("view", this._views.value);
    if (this._colors.selectedIndex) said.set("colors", this._colors.value);
    if (!range.auto) said.set("range", `${range.low}:${range.high}`);
    if (this.name === "surface" && this._projection.turned) said.set("turn", `${Math.round(this._projection.azimuth)}:${Math.round(this._projection.elevation)}`);
    return said.size ? `?${said}` : "";
  }

  /** @returns {string} the page's address with its colours, as another browser may remember others */
  get link() {
    const [name, query] = location.hash.split("?");
    const said = new URLSearchParams(query);
    said.set("colors", this._colors.value);
    return `${location.href.split("#")[0]}${name}?${String(said).replaceAll("%3A", ":")}`;
  }

  /** Fetch the colours. */
  async load() {
    const { value } = this._colors;
    const [colors, signed] = await Promise.all([api.colormap(value), api.colormap(DIFFERENCE_COLORS)]);
    if (value !== this._colors.value) return; // others were chosen meanwhile
    this.colormap = new Colormap(colors.colors);
    this._signed = new Colormap(signed.colors, true);
    this._onChange();
  }

  async _recolor() {
    saveSetting(KEY, this._colors.value);
    await this.load().catch((error) => notice(`Colours not changed: ${messageOf(error)}`, true));
  }

  _show() {
    byId("maps").dataset.view = this.name;
    byId("main").classList.toggle("single", SINGLE.has(this.name));
    byId("split-choice").hidden = this.name !== "slider";
  }

  _cut() {
    byId("boxes").style.setProperty("--split", `${this._split.value}%`);
    byId("boxes").style.setProperty("--cut", String(this.cut));
  }
}

/** Choose an option, if there is one. @param {HTMLSelectElement} select @param {string|null} value */
function pick(select, value) {
  if ([...select.options].some((each) => each.value === value)) select.value = value ?? "";
}
