/**
 * All sensors at once: a small restored map of each, with its force and state.
 * @module
 */

import { Colorbar } from "./colorbar.js";
import { byId } from "./paint.js";
import { Tile } from "./tile.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */

const READ_MS = 200; // between two updates of the words

export class Wall {
  /**
   * @param {Viewer} viewer whose scale and palette the wall shares
   * @param {(name: string) => void} onChoose
   */
  constructor(viewer, onChoose) {
    this._viewer = viewer;
    this._onChoose = onChoose;
    this._root = byId("wall");
    this._grid = byId("tiles");
    this._colorbar = new Colorbar(byId("wall-colorbar"));
    /** @type {Tile[]} */
    this._tiles = [];
    this._dirty = false;
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
    if (this.open && names.join("\n") === this._tiles.map((each) => each.name).join("\n")) return;
    this.close();
    this._root.hidden = false;
    byId("main").hidden = true;
    this._tiles = names.map((name) => new Tile(name, () => this.refresh(), () => this._onChoose(name)));
    this._grid.replaceChildren(...this._tiles.map((each) => each.element));
    for (const tile of this._tiles) tile.start();
    this._timer = setInterval(() => this._read(), READ_MS);
    this._colorbar.forget();
    this.refresh();
  }

  /** Show a single sensor's page again. */
  close() {
    if (!this.open) return;
    clearInterval(this._timer);
    for (const tile of this._tiles) tile.stop();
    this._tiles = [];
    this._grid.replaceChildren();
    this._root.hidden = true;
    byId("main").hidden = false;
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
    requestAnimationFrame(() => this._paint());
  }

  _paint() {
    this._dirty = false;
    const { palette, scale } = this._viewer;
    if (!palette || !this.open) return;
    let peak = 0;
    let noise = 0;
    for (const tile of this._tiles) {
      peak = Math.max(peak, tile.peak);
      noise = Math.max(noise, tile.noise);
    }
    scale.follow(peak, noise, performance.now() / 1000);
    this._colorbar.draw(scale, palette);
    for (const tile of this._tiles) tile.paint(scale, palette);
  }

  _read() {
    for (const tile of this._tiles) tile.read();
  }
}
