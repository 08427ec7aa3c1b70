/** Where a sensor's cells are, in mm: x to the right, y down. @module */

/** @import { Geometry } from "../wire/api.js" */
/** @import { Packet } from "../wire/wire.js" */

/**
 * One image's cells.
 * @typedef {object} Cells
 * @property {number} rows
 * @property {number} columns
 * @property {number} count
 * @property {Float64Array} x mm, centre of each cell
 * @property {Float64Array} y mm
 * @property {number} side mm, drawn side or diameter of one cell
 * @property {Float64Array} area mm^2 that each cell's pressure acts on; 0 of one that no taxel feels: it has no data
 * @property {number} felt how many cells taxels feel
 * @property {boolean} isRaster they are squares in rows and columns, from the plane's corner on
 */

/** @typedef {"x"|"y"} Axis */

/** The other axis of each: what runs along one crosses it. */
export const ACROSS = /** @type {const} */ ({ x: "y", y: "x" });
const TALL_RATIO = 2; // heights of a plane in its width, from which its cross-section runs along y at first

export class Plane {
  /** @param {Geometry} geometry */
  constructor(geometry) {
    const { raw, restored, shape } = geometry;
    /** Whether the taxels are in rows and columns, as the cells of the restored image always are. */
    this.isGrid = shape !== null;
    this.round = geometry.aperture === "round";
    this.pitch = geometry.pitch_mm;
    this.aperture = geometry.aperture_mm;
    const xs = geometry.positions_mm.map((each) => each[0]);
    const ys = geometry.positions_mm.map((each) => each[1]);
    const cell = restored.cell_mm;
    /** Left and top edge, mm. */
    this.left = restored.origin_mm[0] - cell / 2;
    this.top = restored.origin_mm[1] - cell / 2;
    /** Extent, mm. */
    this.width = restored.columns * cell;
    this.height = restored.rows * cell;
    /** @type {Cells} */
    this.restored = this._raster(restored.rows, restored.columns, cell, restored.mask);
    /** @type {Cells} */
    this.raw = this.isGrid
      ? this._raster(raw.rows, raw.columns, this.pitch, null)
      : scattered(xs, ys, this.aperture, Float64Array.from(geometry.areas_mm2 ?? []));
    /** Cells of a scattered layout as they lie along each axis, for cross-sections. */
    this.order = {
      x: Int32Array.from(xs.keys()).sort((a, b) => xs[a] - xs[b]),
      y: Int32Array.from(ys.keys()).sort((a, b) => ys[a] - ys[b]),
    };
  }

  /** @returns {Axis} what a cross-section runs along at first */
  get along() {
    return this.height > TALL_RATIO * this.width ? "y" : "x";
  }

  /** @param {Axis} axis @returns {number} mm, where the plane begins */
  start(axis) {
    return axis === "x" ? this.left : this.top;
  }

  /** @param {Axis} axis @returns {number} mm, how far it reaches from there */
  extent(axis) {
    return axis === "x" ? this.width : this.height;
  }

  /** @param {number} rows @param {number} columns @param {number} side @param {boolean[][]|null} mask @returns {Cells} */
  _raster(rows, columns, side, mask) {
    const count = rows * columns;
    const x = new Float64Array(count);
    const y = new Float64Array(count);
    for (let i = 0; i < count; i += 1) {
      x[i] = this.left + ((i % columns) + 0.5) * side;
      y[i] = this.top + (Math.floor(i / columns) + 0.5) * side;
    }
    const area = mask ? Float64Array.from(mask.flat(), (felt) => (felt ? side * side : 0)) : new Float64Array(count).fill(side * side);
    return { rows, columns, count, x, y, side, area, felt: area.filter(Boolean).length, isRaster: true };
  }

  /**
   * @param {Cells} cells
   * @param {number} x mm
   * @param {number} y mm
   * @returns {number} index of the cell there; -1 where there is none
   */
  find(cells, x, y) {
    if (cells.isRaster) {
      const column = Math.floor((x - this.left) / cells.side);
      const row = Math.floor((y - this.top) / cells.side);
      const cell = row * cells.columns + column;
      return column < 0 || row < 0 || column >= cells.columns || row >= cells.rows || !cells.area[cell] ? -1 : cell;
    }
    let best = -1;
    let nearest = (0.75 * this.pitch) ** 2;
    for (let i = 0; i < cells.count; i += 1) {
      const distance = (cells.x[i] - x) ** 2 + (cells.y[i] - y) ** 2;
      if (distance < nearest) {
        nearest = distance;
        best = i;
      }
    }
    return best;
  }
}

/** @param {Packet} image @param {Cells} cells @returns {boolean} it has a value for each of these cells, in as many rows */
export const isImageOf = ({ rows, columns }, cells) => rows === cells.rows && columns === cells.columns;

/**
 * @param {Plane} plane
 * @param {[number, number][]} points mm
 * @returns {{name: string, corners: [number, number][]}|null} the restored cell in which all of them lie; null for none
 */
export function cellAround(plane, points) {
  const { restored: cells } = plane;
  const [cell, ...others] = points.map(([x, y]) => plane.find(cells, x, y));
  if (cell < 0 || others.some((each) => each !== cell)) return null;
  const name = `cell r${Math.floor(cell / cells.columns)} c${cell % cells.columns}`;
  const [x, y, half] = [cells.x[cell], cells.y[cell], cells.side / 2];
  return { name, corners: [[x - half, y - half], [x + half, y + half]] };
}

/**
 * @param {number[]} xs
 * @param {number[]} ys
 * @param {number} side
 * @param {Float64Array} area
 * @returns {Cells}
 */
function scattered(xs, ys, side, area) {
  const count = xs.length;
  return { rows: 1, columns: count, count, x: Float64Array.from(xs), y: Float64Array.from(ys), side, area, felt: count, isRaster: false };
}
