/** All sensors at once: a small restored map of each, with its force and state. @module */

import { wallUrl } from "../wire/api.js";
import { Colorbar } from "../maps/colorbar.js";
import { byId } from "./dom.js";
import { Tile } from "./tile.js";
import { unitOf } from "./units.js";
import { WallStream } from "../wire/wall_stream.js";
import { PRESSURES, RESTORED, SHEAR, TRACTION, kindsOf } from "../wire/wire.js";

/** @import { Sensor } from "../wire/api.js" */
/** @import { Colormap } from "../maps/colormap.js" */
/** @import { DisplayRange } from "../maps/display_range.js" */
/** @import { Viewer } from "./viewer.js" */

const READ_MS = 200; // between two updates of the texts
const RATE_HZ = 40; // of each sensor, at most: of one at 100 Hz every third image
const GAP_PX = 12; // between tiles
const PADDING_PX = 26; // of a tile's width beside its map: what the style pads
const TEXT_HEIGHT_PX = 126; // of its height above and below: name, scale, force and warnings
const SECOND_LINE_PX = 20; // that a long name takes more
const MIN_MAP_PX = 100; // side of a map, below which the wall is scrolled instead

/**
 * @param {number} count of tiles, at least one
 * @param {number} width that they share, CSS px
 * @param {number} height
 * @param {number} around a tile's map, above and below it
 * @returns {{columns: number, side: number}} how many in a row, and the height of a tile's map
 */
function arrange(count, width, height, around) {
  let best = { columns: 1, side: 0 };
  for (let columns = 1; columns <= count; columns += 1) {
    const rows = Math.ceil(count / columns);
    const wide = (width + GAP_PX) / columns - GAP_PX - PADDING_PX;
    const side = Math.floor(Math.min(wide, (height + GAP_PX) / rows - GAP_PX - around));
    if (side > best.side) best = { columns, side };
  }
  if (best.side >= MIN_MAP_PX) return best;
  const columns = Math.max(1, Math.floor((width + GAP_PX) / (MIN_MAP_PX + PADDING_PX + GAP_PX))); // the page scrolls
  return { columns, side: Math.floor(Math.max(1, (width + GAP_PX) / columns - GAP_PX - PADDING_PX)) };
}

export class Wall {
  /** @param {Viewer} viewer whose range and colour map the wall shares @param {(name: string) => void} onChoose */
  constructor(viewer, onChoose) {
    this._viewer = viewer;
    this._onChoose = onChoose;
    this._root = byId("wall");
    this._skipLink = /** @type {HTMLAnchorElement} */ (byId("skip"));
    this._grid = byId("tiles");
    /** By unit of pressure. */
    this._colorbars = ["wall-colorbar", "wall-colorbar-counts"].map((id) => new Colorbar(/** @type {HTMLCanvasElement} */ (byId(id))));
    /** @type {Tile[]} */
    this._tiles = [];
    /** @type {WallStream|null} */
    this._streams = null;
    this._url = "";
    this._dirty = false;
    this._paint = this._paint.bind(this);
    this._timer = 0;
    byId("wall-scale").addEventListener("change", () => this.restyle());
  }

  /** @returns {boolean} */
  get open() {
    return !this._root.hidden;
  }

  /** Show these sensors; called again, it changes nothing where they are the same. @param {Sensor[]} sensors */
  show(sensors) {
    const names = sensors.map((each) => each.name);
    const shown = sensors.map((each) => (this._viewer.shear ? kindsOf(each).slice(PRESSURES.length).pop() ?? RESTORED : RESTORED));
    const having = (/** @type {number} */ kind) => names.filter((_, i) => shown[i] === kind);
    const url = wallUrl(names, having(SHEAR), having(TRACTION), RATE_HZ);
    if (this.open && url === this._url) {
      this._streams?.retry(); // the service answers, whatever the link's own wait
      return;
    }
    this.close();
    this._root.hidden = false;
    byId("main").hidden = true;
    this._skipLink.hash = "tiles";
    const streams = new WallStream(url);
    this._url = url;
    this._tiles = names.map(
      (name, i) => new Tile(name, shown[i], streams, () => this.refresh(), () => this._onChoose(name)),
    );
    this._tiles.forEach((each, i) => { each.unit = unitOf(sensors[i].unit); });
    this._grid.replaceChildren(...this._tiles.map((each) => each.element));
    this._arrange();
    for (const tile of this._tiles) tile.start();
    this._streams = streams;
    streams.open();
    this._timer = setInterval(() => this._read(), READ_MS);
    this._forgetLegends();
    this.refresh();
  }

  /** Draw every legend again. */
  _forgetLegends() {
    for (const each of this._colorbars) each.forget();
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
    this._skipLink.hash = "maps";
    if (focused) byId("maps").focus({ preventScroll: true }); // what had it is gone
  }

  /** Another size or theme. */
  restyle() {
    this._forgetLegends();
    this._arrange();
    for (const tile of this._tiles) tile.layout();
    this.refresh();
  }

  /** Choose how many tiles stand in a row; where a name is cut there, all names have two lines. */
  _arrange() {
    if (!this.open) return;
    this._grid.classList.remove("long");
    this._setTileSize(TEXT_HEIGHT_PX);
    if (!this._tiles.some((each) => each.cut)) return;
    this._grid.classList.add("long");
    this._setTileSize(TEXT_HEIGHT_PX + SECOND_LINE_PX);
  }

  /**
   * Make the maps as large as the window lets them be.
   * @param {number} around a tile's map, above and below it, CSS px
   */
  _setTileSize(around) {
    const legend = /** @type {HTMLElement} */ (byId("wall-legend"));
    const height = window.innerHeight - this._grid.offsetTop - legend.offsetHeight - 2 * GAP_PX;
    const { columns, side } = arrange(this._tiles.length, this._grid.clientWidth, height, around);
    this._grid.style.setProperty("--columns", String(columns));
    this._grid.style.setProperty("--box", `${side}px`);
  }

  /** Paint at the screen's next turn. */
  refresh() {
    if (this._dirty || !this.open) return;
    this._dirty = true;
    requestAnimationFrame(this._paint);
  }

  _paint() {
    this._dirty = false;
    const { view: { colormap, ownScales }, ranges } = this._viewer;
    if (!colormap || !this.open) return;
    if (!ownScales) {
      for (let unit = 0; unit < ranges.length; unit += 1) this._paintUnit(unit, ranges[unit], colormap);
      return;
    }
    for (const each of this._colorbars) /** @type {HTMLElement} */ (each.canvas.parentElement).hidden = true;
    for (let i = 0; i < this._tiles.length; i += 1) this._tiles[i].paint(this._tiles[i].follow(), colormap);
  }

  /**
   * Paint the sensors of one unit of pressure, on one scale.
   * @param {number} unit
   * @param {DisplayRange} range
   * @param {Colormap} colormap
   */
  _paintUnit(unit, range, colormap) {
    let peak = 0;
    let noise = 0;
    let count = 0;
    for (let i = 0; i < this._tiles.length; i += 1) {
      if (this._tiles[i].unit !== unit) continue;
      count += 1;
      peak = Math.max(peak, this._tiles[i].peak);
      noise = Math.max(noise, this._tiles[i].noise);
    }
    const colorbar = this._colorbars[unit];
    /** @type {HTMLElement} */ (colorbar.canvas.parentElement).hidden = !count;
    if (!count) return;
    range.follow(peak, noise, performance.now() / 1000);
    colorbar.draw(range, colormap, unit);
    for (let i = 0; i < this._tiles.length; i += 1) {
      if (this._tiles[i].unit === unit) this._tiles[i].paint(range, colormap);
    }
  }

  _read() {
    for (const tile of this._tiles) tile.read();
  }
}
