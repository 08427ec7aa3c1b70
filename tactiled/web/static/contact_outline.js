/**
 * The outlines of contacts: the edges of their own cells in the frame that is shown, so that a ring has a hole. The
 * service finds contacts in some of the frames alone: their cells are found again in each, from where they were.
 * @module
 */

/** @import { Frame } from "./frame_history.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { Contact } from "./sensor_stream.js" */

const CLEAR_DEVIATIONS = 5; // of the noise from which a cell is pressed, and
const PEAK_SHARE = 0.1; // of its contact's peak: as the service's contacts have it
const WITHIN_DEVIATIONS = 3; // of its pressure, from a contact's centre to cells that are its own

export class ContactOutline {
  constructor() {
    /** Ends of each edge, in cells: from column, from row, to column, to row. */
    this.edges = new Uint16Array(0);
    this.count = 0;
    /** mm, of a cell. */
    this.side = 1;
    /** By contact, how many cells it has in the frame: 0, it is not there. */
    this.cells = new Uint32Array(0);
    /** @type {Uint8Array} by contact, whether it has an outline */
    this.outlined = new Uint8Array(0);
    /** Cells by contact: its westernmost and northernmost edge, its easternmost and southernmost. */
    this.extents = new Uint16Array(0);
    /** mm by contact, where its pressure is centred: x, y. */
    this.centres = new Float32Array(0);
    this._weights = new Float32Array(0);
    this._owners = new Uint8Array(0);
    this._queue = new Uint32Array(0);
    this._sequence = -1;
    /** @type {Contact[]|null} */
    this._contacts = null;
  }

  /**
   * Find the edges, where frame or contacts are others than the last time.
   * @param {Frame} frame
   * @param {Plane} plane
   * @param {Contact[]|null} contacts of this frame, or of one near it
   */
  update(frame, plane, contacts) {
    if (contacts === this._contacts && frame.sequence === this._sequence) return;
    this._contacts = contacts;
    this._sequence = frame.sequence;
    this.count = 0;
    const n = Math.min(255, contacts?.length ?? 0);
    if (this.cells.length !== n) {
      this.cells = new Uint32Array(n);
      this.outlined = new Uint8Array(n);
      this.extents = new Uint16Array(4 * n);
      this.centres = new Float32Array(2 * n);
      this._weights = new Float32Array(n);
    }
    for (const each of [this.cells, this.outlined, this.extents, this.centres, this._weights]) each.fill(0);
    if (!contacts || !n) return;
    const { count, side, rows, columns } = plane.restored;
    this.side = side;
    if (this._owners.length !== count) {
      this._owners = new Uint8Array(count);
      this._queue = new Uint32Array(count);
      this.edges = new Uint16Array(16 * count);
    }
    this._owners.fill(0);
    const noise = CLEAR_DEVIATIONS * (frame.noise || 0) * (frame.noiseGain || 1);
    for (let i = n; i > 0; i -= 1) this._claim(frame.restored, plane, contacts[i - 1], i, noise);
    if (plane.isGrid) this._grow(frame.restored, contacts, rows, columns, noise);
    this._centre(frame.restored, plane);
    if (plane.isGrid) this._findEdges(rows, columns);
  }

  /**
   * Give a contact its cells; a stronger one, which comes later, may take them.
   * @param {Float32Array} values
   * @param {Plane} plane
   * @param {Contact} contact
   * @param {number} owner its number in the list, from 1
   * @param {number} floor pressure that a cell exceeds
   */
  _claim(values, { restored: { x, y, count, side } }, contact, owner, floor) {
    const least = Math.max(floor, PEAK_SHARE * contact.peak);
    const cos = Math.cos(contact.angle_rad);
    const sin = Math.sin(contact.angle_rad);
    const major = WITHIN_DEVIATIONS * Math.max(contact.major_mm, side / 2);
    const minor = WITHIN_DEVIATIONS * Math.max(contact.minor_mm, side / 2);
    for (let i = 0; i < count; i += 1) {
      if (!(values[i] > least)) continue;
      const dx = x[i] - contact.x_mm;
      const dy = y[i] - contact.y_mm;
      if (((dx * cos + dy * sin) / major) ** 2 + ((dy * cos - dx * sin) / minor) ** 2 <= 1) this._owners[i] = owner;
    }
  }

  /**
   * Give each contact the pressed cells beside its own, as it may have moved or turned.
   * @param {Float32Array} values
   * @param {Contact[]} contacts
   * @param {number} rows
   * @param {number} columns
   * @param {number} floor pressure that a cell exceeds
   */
  _grow(values, contacts, rows, columns, floor) {
    const { _owners: owners, _queue: queue } = this;
    let end = 0;
    for (let i = 0; i < owners.length; i += 1) if (owners[i]) queue[end++] = i;
    for (let at = 0; at < end; at += 1) {
      const i = queue[at];
      const column = i % columns;
      const least = Math.max(floor, PEAK_SHARE * contacts[owners[i] - 1].peak);
      for (let side = 0; side < 4; side += 1) {
        const beside = i + (side === 0 ? -columns : side === 1 ? columns : side === 2 ? -1 : 1);
        if (beside < 0 || beside >= rows * columns || (side === 2 && !column) || (side === 3 && column === columns - 1)) continue;
        if (owners[beside] || !(values[beside] > least)) continue;
        owners[beside] = owners[i];
        queue[end++] = beside;
      }
    }
  }

  /** Count each contact's cells, and find their centre. @param {Float32Array} values @param {Plane} plane */
  _centre(values, { restored: { x, y, area } }) {
    const { _owners: owners, centres, cells, _weights: weights } = this;
    for (let i = 0; i < owners.length; i += 1) {
      const n = owners[i] - 1;
      if (n < 0) continue;
      const weight = values[i] * area[i];
      cells[n] += 1;
      weights[n] += weight;
      centres[2 * n] += weight * x[i];
      centres[2 * n + 1] += weight * y[i];
    }
    for (let n = 0; n < cells.length; n += 1) {
      centres[2 * n] /= weights[n];
      centres[2 * n + 1] /= weights[n];
    }
  }

  /** @param {number} rows @param {number} columns */
  _findEdges(rows, columns) {
    const { _owners: owners } = this;
    for (let row = 0; row < rows; row += 1) {
      for (let column = 0; column < columns; column += 1) {
        const i = row * columns + column;
        const owner = owners[i];
        if (!owner) continue;
        this._extend(owner - 1, row, column);
        if (!row || owners[i - columns] !== owner) this._edge(column, row, column + 1, row);
        if (row === rows - 1 || owners[i + columns] !== owner) this._edge(column, row + 1, column + 1, row + 1);
        if (!column || owners[i - 1] !== owner) this._edge(column, row, column, row + 1);
        if (column === columns - 1 || owners[i + 1] !== owner) this._edge(column + 1, row, column + 1, row + 1);
      }
    }
  }

  /** @param {number} contact @param {number} row @param {number} column */
  _extend(contact, row, column) {
    const { extents } = this;
    const at = 4 * contact;
    const isFirst = !this.outlined[contact]; // and the northernmost, as rows come in order
    extents[at] = isFirst ? column : Math.min(extents[at], column);
    if (isFirst) extents[at + 1] = row;
    extents[at + 2] = Math.max(extents[at + 2], column + 1);
    extents[at + 3] = row + 1;
    this.outlined[contact] = 1;
  }

  /** @param {number} x @param {number} y @param {number} toX @param {number} toY */
  _edge(x, y, toX, toY) {
    const at = 4 * this.count;
    this.edges[at] = x;
    this.edges[at + 1] = y;
    this.edges[at + 2] = toX;
    this.edges[at + 3] = toY;
    this.count += 1;
  }
}
