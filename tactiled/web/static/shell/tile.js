/** One sensor on the wall. @module */

import * as api from "../wire/api.js";
import { DisplayRange } from "../maps/display_range.js";
import { element, setText } from "./dom.js";
import { fixed } from "./format.js";
import { LATE_MS, latencyOf } from "./frame_rate.js";
import { Freshness } from "./freshness.js";
import { Plane, isImageOf } from "../maps/geometry.js";
import { CONNECTING, healthOf } from "./health.js";
import { Heatmap } from "../maps/heatmap.js";
import { measure, measures } from "../maps/measures.js";
import { messageOf } from "./notice.js";
import { ON_COVER, SENSED, ShearArrows } from "../maps/shear_arrows.js";
import { tickText } from "../charts/ticks.js";
import { UNITS, forceText } from "./units.js";
import { Warnings } from "./warnings.js";
import { RESTORED, SHEAR } from "../wire/wire.js";

/** @import { Colormap } from "../maps/colormap.js" */
/** @import { Status } from "../wire/sensor_stream.js" */
/** @import { WallStream } from "../wire/wall_stream.js" */
/** @import { Packet } from "../wire/wire.js" */

const RETRY_MS = 2000; // until a shape is requested again that could not be had

/** @returns {HTMLCanvasElement} one that is not read out */
function layer() {
  const canvas = document.createElement("canvas");
  canvas.setAttribute("aria-hidden", "true");
  return canvas;
}

export class Tile {
  /**
   * @param {string} name of the sensor
   * @param {number} last kind of its images: SHEAR or TRACTION, or RESTORED where it has no shear
   * @param {WallStream} streams that it is one of
   * @param {() => void} onImage there is something to paint
   * @param {() => void} onChoose
   */
  constructor(name, last, streams, onImage, onChoose) {
    this.name = name;
    /** Largest pressure of the newest image, in `unit`. */
    this.peak = 0;
    /** Standard deviation of a restored cell. */
    this.noise = 0;
    /** Of pressure, index in UNITS. */
    this.unit = 0;
    this._onImage = onImage;
    const canvas = layer();
    this._frame = element("span", "frame", canvas);
    this._box = element("span", "box", this._frame);
    this._low = element("span", "");
    this._ramp = element("i", "");
    this._high = element("span", "");
    const scale = element("span", "scale", "restored", this._low, this._ramp, this._high);
    this._state = element("span", "sub");
    this._force = element("span", "force");
    this._warningText = element("span", "warning");
    const under = element("span", "under", this._warningText);
    this._last = last;
    this._arrows = last === RESTORED ? null : this._addArrows(under);
    this._title = element("b", "");
    this._title.title = name;
    for (const part of name.split(/(?<=_)/)) this._title.append(part, element("wbr", ""));
    const head = element("span", "head", element("span", "dot"), this._title);
    this.element = element("button", "tile", head, this._box, scale, element("span", "foot", this._force, this._state), under);
    this.element.setAttribute("type", "button");
    this.element.dataset.level = "connecting";
    this.element.addEventListener("click", onChoose);
    this._range = new DisplayRange();
    /** What the scale was last drawn for. */
    this._scale = { low: NaN, high: NaN, unit: 0, colormap: /** @type {Colormap|null} */ (null) };
    this._map = new Heatmap(canvas, this._frame);
    this._of = measures();
    this._freshness = new Freshness();
    this._recent = new Warnings();
    /** @type {string[]} */
    this._warnings = [];
    this._sent = this._sequence = NaN; // of the newest image
    this._unpainted = false;
    this._values = new Float32Array(0);
    this._shear = new Float32Array(0);
    this._timestamp = NaN;
    this._latency = NaN; // ms, of the image that is painted
    /** @type {Plane|null} */
    this._plane = null;
    this._part = streams.part(name, {
      onImage: (image) => this._takeImage(image),
      onStatus: (status) => {
        this._status = status;
        if ((status.sequence ?? -1) < this._sequence) this._restart();
        this._warnings = this._recent.hold(status.warnings, performance.now());
        this._statusAt = performance.now();
        if (this._freshness.noneNewer(status, this._sequence, Date.now() / 1000)) this._show();
      },
      onLink: () => this._request(),
    });
    /** @type {Status|null} */
    this._status = null;
    this._statusAt = 0;
    this._imageAt = 0;
    this._fresh = false;
    this._stopped = false;
  }

  /** Lay arrows over the map. @param {HTMLElement} under where their key is to stand @returns {ShearArrows} */
  _addArrows(under) {
    const canvas = layer();
    const key = element("span", "shear-key", layer(), element("span", ""));
    key.hidden = true;
    key.title = "Shear: the longest arrow, x to the right, y down";
    this._frame.append(canvas);
    under.append(key);
    return new ShearArrows(canvas, key, this._last === SHEAR ? SENSED : ON_COVER);
  }

  /** Learn the sensor's shape, again and again until it is there, and ask for its images. */
  async start() {
    try {
      const plane = new Plane(await api.geometry(this.name));
      if (this._stopped) return;
      this._plane = plane;
      this._values = new Float32Array(plane.restored.count).fill(NaN);
      this._shear = new Float32Array(2 * plane[this._last === SHEAR ? "raw" : "restored"].count).fill(NaN);
      this._map.use(plane, plane.restored);
      this.layout();
    } catch (error) {
      setText(this._force, messageOf(error));
      if (!this._stopped) setTimeout(() => this._stopped || this.start(), RETRY_MS);
      return;
    }
    this._request();
  }

  /** @returns {boolean} the name has no room on its line */
  get cut() {
    return this._title.scrollWidth > this._title.clientWidth;
  }

  /** Learn nothing any more. */
  stop() {
    this._stopped = true;
  }

  /** Ask for the next image, once it can be shown. */
  _request() {
    if (this._plane) this._part.next();
  }

  /** Make the map as large as its box allows, true to scale. */
  layout() {
    const plane = this._plane;
    if (plane) {
      const zoom = Math.min(this._box.clientWidth / plane.width, this._box.clientHeight / plane.height);
      this._map.resize(zoom);
      this._arrows?.resize(plane, zoom);
    }
    this._fresh = plane !== null && this._imageAt > 0;
  }

  /** @param {Packet} image */
  _takeImage(image) {
    const plane = this._plane;
    if (!plane) return;
    if (image.sequence < this._sequence || !isImageOf(image, image.kind === SHEAR ? plane.raw : plane.restored)) {
      this._restart();
      return;
    }
    if (image.kind !== RESTORED) {
      this._shear.set(image.shear);
      this._timestamp = image.timestamp;
    } else {
      this._takePressures(image, plane);
      if (this._arrows) return; // its shear is on its way
    }
    this._unpainted = true;
    if (!this._holdBack()) this._show();
  }

  /** The sensor was restarted, or has another shape: learn it anew. */
  _restart() {
    this._plane = null;
    this._sequence = NaN;
    this.start();
  }

  /** @param {Packet} image of pressures @param {Plane} plane */
  _takePressures(image, plane) {
    this._values.set(image.values);
    this._sent = image.sent;
    this._timestamp = image.timestamp;
    this._sequence = image.sequence;
    this._freshness.arrived(image.sent, Date.now() / 1000);
    this._imageAt = performance.now();
    if (image.unit !== this.unit) this._range.reset(); // a calibration was applied
    this.unit = image.unit;
    this.noise = (image.noise || 0) * Math.max(1, image.noiseGain || 1);
    measure(this._values, plane.restored, this.noise, this._of, image.unit);
    this.peak = this._of.highest || 0;
  }

  /** Let the newest image be painted. */
  _show() {
    this._freshness.release();
    this._fresh = true;
    this._onImage();
  }

  /** @returns {boolean} an image came, but waited too long: another is requested */
  _holdBack() {
    if (!this._unpainted || this._status?.state !== "live" || !this._freshness.holdBack(this._sent, 1, Date.now() / 1000)) return false;
    this._unpainted = false;
    this._request();
    return true;
  }

  /** @returns {DisplayRange} of this sensor alone, after its newest image */
  follow() {
    this._range.follow(this.peak, this.noise, performance.now() / 1000);
    return this._range;
  }

  /**
   * Show the scale where it is another than the last time.
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   * @returns {boolean} it is
   */
  _rescale({ low, high }, colormap) {
    const { unit, _scale: last } = this;
    if (low === last.low && high === last.high && unit === last.unit && colormap === last.colormap) return false;
    this._scale = { low, high, unit, colormap };
    setText(this._low, tickText(low, high - low));
    setText(this._high, `${tickText(high, high - low)} ${UNITS[unit]}`);
    this._ramp.style.background = `linear-gradient(90deg, ${colormap.css.filter((_, i) => i % 15 === 0 && i < 256).join()})`;
    return true;
  }

  /**
   * Show what is new.
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   */
  paint(range, colormap) {
    if (this._freshness.heldBack || this._holdBack()) return;
    const rescaled = this._rescale(range, colormap);
    if (!this._fresh && !(rescaled && this._imageAt)) return;
    this._map.paint(this._values, range, colormap);
    this._arrows?.draw(this._shear, this._timestamp);
    if (this._fresh) {
      this._latency = latencyOf(this._timestamp, this._freshness.minDelay, Date.now() / 1000);
      this._freshness.painted();
    }
    this._fresh = this._unpainted = false;
    this._request();
  }

  /** Bring the texts up to date. */
  read() {
    const health = this._plane
      ? healthOf(this._part.socket, this._part, this._status, this._statusAt, this._imageAt, performance.now()) : CONNECTING;
    const live = health.level === "live";
    if (this.element.dataset.level !== health.level) this.element.dataset.level = health.level;
    this._warn(live ? this._warnings : []);
    const late = this._latency > LATE_MS ? `, ${fixed(this._latency / 1000, 1)} s late` : "";
    setText(this._state, live ? `${fixed(this._status?.rate_hz ?? NaN, 0)} Hz${late}` : health.level === "down" ? "bus down" : health.level === "ended" ? "end of recording" : health.level);
    if (!this._plane || (live && this._freshness.heldBack)) return;
    setText(this._force, live || health.level === "ended" ? this._imageAt ? forceText(this._of.force, this.unit) : "\u2013" : health.text);
  }

  /** @param {string[]} warnings that hold of what is shown */
  _warn(warnings) {
    const count = warnings.length;
    this.element.classList.toggle("warned", count > 0);
    setText(this._warningText, count ? `${count} ${count === 1 ? "warning" : "warnings"}: ${warnings.join("; ")}` : "");
    const all = warnings.join("\n");
    if (this._warningText.title !== all) this._warningText.title = all;
  }
}
