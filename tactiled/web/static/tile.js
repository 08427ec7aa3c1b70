/**
 * One sensor on the wall.
 * @module
 */

import * as api from "./api.js";
import { judge } from "./health.js";
import { Heatmap } from "./heatmap.js";
import { measure, measures } from "./measures.js";
import { words } from "./notice.js";
import { fixed, say } from "./paint.js";
import { Plane } from "./plane.js";

/** @typedef {import("./wire.js").Packet} Packet */

const AGAIN_MS = 2000; // until a shape is asked for again that could not be had

/**
 * @param {string} tag
 * @param {string} name its class
 * @param {...Node} children
 * @returns {HTMLElement}
 */
function make(tag, name, ...children) {
  const made = document.createElement(tag);
  made.className = name;
  made.append(...children);
  return made;
}

export class Tile {
  /**
   * @param {string} name of the sensor
   * @param {import("./streams.js").Streams} streams that it is one of
   * @param {() => void} onImage there is something to paint
   * @param {() => void} onChoose
   */
  constructor(name, streams, onImage, onChoose) {
    this.name = name;
    /** Largest pressure of the newest image, kPa. */
    this.peak = 0;
    /** Standard deviation of a restored cell, kPa. */
    this.noise = 0;
    this._onImage = onImage;
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    this._frame = make("span", "frame", canvas);
    this._box = make("span", "box", this._frame);
    this._state = make("span", "sub");
    this._force = make("span", "force");
    const title = make("b", "", document.createTextNode(name));
    this.element = make("button", "tile", make("span", "head", make("span", "dot"), title, this._state), this._box, this._force);
    this.element.setAttribute("type", "button");
    this.element.dataset.level = "connecting";
    this.element.addEventListener("click", onChoose);
    this._map = new Heatmap(canvas, this._frame);
    this._of = measures();
    this._kpa = new Float32Array(0);
    /** @type {Plane|null} */
    this._plane = null;
    this._part = streams.part(name, {
      onImage: (image) => this._take(image),
      onStatus: (status) => {
        this._status = status;
        this._toldAt = performance.now();
      },
      onLink: () => this._ask(),
    });
    /** @type {import("./stream.js").Status|null} */
    this._status = null;
    this._toldAt = 0;
    this._imageAt = 0;
    this._fresh = false;
    this._stopped = false;
  }

  /** Learn the sensor's shape, again and again until it is there, and ask for its images. */
  async start() {
    try {
      const plane = new Plane(await api.geometry(this.name));
      if (this._stopped) return;
      this._plane = plane;
      this._kpa = new Float32Array(plane.restored.count).fill(NaN);
      this._map.use(plane, plane.restored);
      this.layout();
    } catch (error) {
      say(this._force, words(error));
      if (!this._stopped) setTimeout(() => this._stopped || this.start(), AGAIN_MS);
      return;
    }
    this._ask();
  }

  /** Learn nothing any more. */
  stop() {
    this._stopped = true;
  }

  /** Ask for the next image, once it can be shown. */
  _ask() {
    if (this._plane) this._part.next();
  }

  /** Make the map as large as its box allows, true to scale. */
  layout() {
    const plane = this._plane;
    if (plane) this._map.resize(Math.min(this._box.clientWidth / plane.width, this._box.clientHeight / plane.height));
    this._fresh = plane !== null && this._imageAt > 0;
  }

  /** @param {Packet} image */
  _take(image) {
    const plane = this._plane;
    if (!plane) return;
    if (image.kpa.length !== this._kpa.length) {
      this._plane = null;
      this.start();
      return;
    }
    this._kpa.set(image.kpa);
    this._imageAt = performance.now();
    this.noise = (image.noiseKpa || 0) * Math.max(1, image.noiseGain || 1);
    measure(this._kpa, plane.restored, this.noise, this._of);
    this.peak = this._of.peak || 0;
    this._fresh = true;
    this._onImage();
  }

  /**
   * Show what is new.
   * @param {import("./scale.js").Scale} scale
   * @param {import("./heatmap.js").Palette} palette
   * @param {boolean} rescaled the scale is another than the last time
   */
  paint(scale, palette, rescaled) {
    if (!this._fresh && !(rescaled && this._imageAt)) return;
    this._map.paint(this._kpa, scale, palette);
    this._fresh = false;
    this._ask();
  }

  /** Bring the words up to date. */
  read() {
    const health = judge(this._plane && this._part, this._status, this._toldAt, this._imageAt);
    const live = health.level === "live";
    if (this.element.dataset.level !== health.level) this.element.dataset.level = health.level;
    say(this._state, live ? `${fixed(this._status?.rate_hz ?? NaN, 0)} Hz` : health.level === "down" ? "bus down" : health.level);
    if (!this._plane) return;
    say(this._force, live ? `${fixed(this._imageAt ? this._of.force : NaN, 2)} N` : health.text);
  }
}
