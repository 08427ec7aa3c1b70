/** The outlines of contacts: the edges of their own cells in the restored image, so that a ring has a hole. @module */

/** @import { Frame } from "./frame_history.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { Contact } from "./sensor_stream.js" */

const CLEAR_DEVIATIONS = 5; // of the noise from which a cell is pressed, and
const PEAK_SHARE = 0.1; // of its contact's peak: as the service's contacts have it
const WITHIN_DEVIATIONS = 3; // of its pressure, from a contact's centre to its cells

export class ContactOutline {
  constructor() {
    /** Ends of each edge, in cells: from column, from row, to column, to row. */
    this.edges = new Uint16Array(0);
    this.count = 0;
    /** mm, of a cell. */
    this.side = 1;
    /** @type {Uint8Array} by contact, whether it has an outline */
    this.outlined = new Uint8Array(0);
    /** Cells by contact: its westernmost and northernmost edge, its easternmost and southernmost. */
    this.extents = new Uint16Array(0);
    this._owners = new Uint8Array(0);
    this._sequence = -1;
    /** @type {Contact[]|null} */
    this._contacts = null;
  }

  /**
   * Find the edges, where frame or contacts are others than the last time.
   * @param {Frame} frame
   * @param {Plane} plane
   * @param {Contact[]|null} contacts
   * @param {boolean} still the frame is looked at by itself; else the outlines follow the contacts
   */
  update(frame, plane, contacts, still) {
    if (contacts === this._contacts && (!still || frame.sequence === this._sequence)) return;
    this._contacts = contacts;
    this._sequence = frame.sequence;
    this.count = 0;
    this.outlined = new Uint8Array(contacts?.length ?? 0);
    this.extents = new Uint16Array(4 * this.outlined.length);
    if (!contacts?.length || !plane.isGrid) return;
    const { count, side } = plane.restored;
    this.side = side;
    if (this._owners.length !== count) {
      this._owners = new Uint8Array(count);
      this.edges = new Uint16Array(16 * count);
    }
    this._owners.fill(0);
    const noise = CLEAR_DEVIATIONS * (frame.noise || 0) * (frame.noiseGain || 1);
    for (let n = Math.min(255, contacts.length); n > 0; n -= 1) this._claim(frame.restored, plane, contacts[n - 1], n, noise);
    this._findEdges(plane.restored.rows, plane.restored.columns);
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
