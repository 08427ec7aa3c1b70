/**
 * All sensors at once: a small restored map of each, with its force and state.
 * @module
 */

import { wallUrl } from "./api.js";
import { Colorbar } from "./colorbar.js";
import { byId } from "./paint.js";
import { Streams } from "./streams.js";
import { Tile } from "./tile.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */

const READ_MS = 200; // between two updates of the words
const RATE_HZ = 15;

export class Wall {
  /**
   * @param {Viewer} viewer whose scale and palette the wall shares
   * @param {(name: string) => void} onChoose
   */
  constructor(viewer, onChoose) {
    this._viewer = viewer;
    this._onChoose = onChoose;
    this._root = byId("wall");
    this._skip = /** @type {HTMLAnchorElement} */ (byId("skip"));
    this._grid = byId("tiles");
    this._colorbar = new Colorbar(byId("wall-colorbar"));
    /** @type {Tile[]} */
    this._tiles = [];
    /** @type {Streams|null} */
    this._streams = null;
    this._dirty = false;
    /** Range of the maps as they were last painted, kPa. */
    this._low = NaN;
    this._high = NaN;
    this._paint = this._paint.bind(this);
    this._timer = 0;
  }

  /** @returns {boolean} */
  get open() {
    return !this._root.hidden;
  }

  /**
   * Show these sensors; called again, it changes nothing where they are the same.
   * @param {import("./api.js").Sensor[]} sensors
   */
  show(sensors) {
    const names = sensors.map((each) => each.name);
    if (this.open && names.join("\n") === this._tiles.map((each) => each.name).join("\n")) {
      this._streams?.retry(); // the service answers, whatever the link's own wait
      return;
    }
    this.close();
    this._root.hidden = false;
    byId("main").hidden = true;
    this._skip.hash = "tiles";
    const streams = new Streams(wallUrl(names, RATE_HZ));
    this._tiles = names.map((name) => new Tile(name, streams, () => this.refresh(), () => this._onChoose(name)));
    this._grid.replaceChildren(...this._tiles.map((each) => each.element));
    for (const tile of this._tiles) tile.start();
    this._streams = streams;
    streams.open();
    this._timer = setInterval(() => this._read(), READ_MS);
    this._colorbar.forget();
    this.refresh();
  }

  /** Show a single sensor's page again. */
  close() {
    if (!this.open) return;
    clearInterval(this._timer);
    const focused = this._grid.contains(document.activeElement);
    this._streams?.stop();
    for (const tile of this._tiles) tile.stop();
    this._tiles = [];
    this._grid.replaceChildren();
    this._root.hidden = true;
    byId("main").hidden = false;
    this._skip.hash = "maps";
    if (focused) byId("maps").focus({ preventScroll: true }); // what had it is gone
  }

  /** Another size or theme. */
  restyle() {
    this._colorbar.forget();
    for (const tile of this._tiles) tile.layout();
    this.refresh();
  }

  /** Paint at the screen's next turn. */
  refresh() {
    if (this._dirty || !this.open) return;
    this._dirty = true;
    requestAnimationFrame(this._paint);
  }

  _paint() {
    this._dirty = false;
    const { palette, scale } = this._viewer;
    if (!palette || !this.open) return;
    let peak = 0;
    let noise = 0;
    for (let i = 0; i < this._tiles.length; i += 1) {
      peak = Math.max(peak, this._tiles[i].peak);
      noise = Math.max(noise, this._tiles[i].noise);
    }
    scale.follow(peak, noise, performance.now() / 1000);
    this._colorbar.draw(scale, palette);
    const rescaled = scale.low !== this._low || scale.high !== this._high;
    this._low = scale.low;
    this._high = scale.high;
    for (let i = 0; i < this._tiles.length; i += 1) this._tiles[i].paint(scale, palette, rescaled);
  }

  _read() {
    for (const tile of this._tiles) tile.read();
  }
}
