/**
 * The outlines of contacts: the edges of their own cells in the frame that is shown, so that a ring has a hole. The
 * service finds contacts in some of the frames alone: their cells are found again in each, from where they were.
 * @module
 */

import { FORCE_SCALES } from "../shell/units.js";

/** @import { Frame } from "../wire/frame_history.js" */
/** @import { Plane } from "./geometry.js" */
/** @import { Contact } from "../wire/sensor_stream.js" */

/** @typedef {{force: number, x: number, y: number, near: Set<number>|null, cut: boolean}} Part cells that hang together, `cut` by an unknown one; `near` are contacts, by their number */

const CLEAR_DEVIATIONS = 5; // of the noise from which a cell is pressed, and
const PEAK_SHARE = 0.1; // of its contact's peak: as the service's contacts have it
const WITHIN_DEVIATIONS = 3; // of its pressure, from a contact's centre to cells that are its own
const SAME_PITCHES = 2; // between the centres of a contact and of cells that hang together, where they are the same
const SAME_RATIO = 1.5; // of their forces
const SHAPE = 6; // numbers of a contact's shape
const MIN_AXIS_MM = 0.1;

/** @param {Contact} contact @param {Float64Array} shapes @param {number} n its number in them */
function shape({ x_mm, y_mm, major_mm, minor_mm, angle_rad }, shapes, n) {
  const major = Math.max(major_mm, MIN_AXIS_MM);
  const minor = Math.max(minor_mm, MIN_AXIS_MM);
  const at = SHAPE * n;
  shapes[at] = x_mm;
  shapes[at + 1] = y_mm;
  shapes[at + 2] = Math.cos(angle_rad) / major;
  shapes[at + 3] = Math.sin(angle_rad) / major;
  shapes[at + 4] = Math.cos(angle_rad) / minor;
  shapes[at + 5] = Math.sin(angle_rad) / minor;
}

/** @param {Float64Array} shapes @param {number} n of a contact @param {number} x mm @param {number} y mm @returns {number} standard deviations of its pressure from its centre */
function distance(shapes, n, x, y) {
  const at = SHAPE * n;
  const dx = x - shapes[at];
  const dy = y - shapes[at + 1];
  const along = dx * shapes[at + 2] + dy * shapes[at + 3];
  const across = dy * shapes[at + 4] - dx * shapes[at + 5];
  return Math.sqrt(along * along + across * across);
}

/** @param {Float64Array} shapes @param {number} x mm @param {number} y mm @param {Set<number>|null} of these contacts; null: of all @returns {number} */
function nearest(shapes, x, y, of) {
  let best = 0;
  let least = Infinity;
  for (let n = 0; n < shapes.length / SHAPE; n += 1) {
    if (of && !of.has(n)) continue;
    const far = distance(shapes, n, x, y);
    if (far >= least) continue;
    best = n;
    least = far;
  }
  return best;
}

/** @typedef {{p: number, n: number, off: number}} Pair a part and a contact, and how unlike they are */

// Of the last match, and used again in the next: a painted frame leaves little to collect.
/** @type {Pair[]} */
const POOL = [];
/** @type {Pair[]} */
const PAIRS = [];
/** @type {number[]} */
const OWNED = [];
/** @type {Set<number>} */
const TAKEN = new Set();

/** @param {Part[]} parts @param {Contact[]} contacts @param {number} pitch mm @returns {number[]} by part, the contact that it is; -1 for none */
function match(parts, contacts, pitch) {
  PAIRS.length = 0;
  OWNED.length = 0;
  TAKEN.clear();
  for (let p = 0; p < parts.length; p += 1) {
    OWNED.push(-1);
    for (let n = 0; n < contacts.length; n += 1) {
      const apart = Math.hypot(parts[p].x - contacts[n].x_mm, parts[p].y - contacts[n].y_mm) / pitch;
      const ratio = Math.abs(Math.log(parts[p].force / contacts[n].force));
      if (apart > SAME_PITCHES || ratio > Math.log(SAME_RATIO)) continue;
      const pair = (POOL[PAIRS.length] ??= { p: 0, n: 0, off: 0.5 });
      pair.p = p;
      pair.n = n;
      pair.off = apart + ratio;
      PAIRS.push(pair);
    }
  }
  PAIRS.sort(byOffset);
  for (let i = 0; i < PAIRS.length; i += 1) {
    const { p, n } = PAIRS[i];
    if (OWNED[p] >= 0 || TAKEN.has(n)) continue;
    OWNED[p] = n;
    TAKEN.add(n);
  }
  return OWNED;
}

/** @param {Pair} a @param {Pair} b @returns {number} */
function byOffset(a, b) {
  return a.off - b.off;
}

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
    this._parts = new Uint16Array(0);
    this._queue = new Uint32Array(0);
    this._shapes = new Float64Array(0); // of contacts: centre, mm, and what makes standard deviations of an offset
    this._sequence = -1;
    /** @type {Set<number>} contacts that own no part */
    this._left = new Set();
    /** @type {Contact[]|null} */
    this._contacts = null;
  }

  /**
   * Find the edges, where frame or contacts are others than the last time.
   * @param {Frame} frame
   * @param {Plane} plane
   * @param {Contact[]|null} contacts of this frame, or of one near it
   * @param {number} [marked] how many of them have an outline
   */
  update(frame, plane, contacts, marked = Infinity) {
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
      this._shapes = new Float64Array(SHAPE * n);
    }
    this.cells.fill(0);
    this.outlined.fill(0);
    this.extents.fill(0);
    this.centres.fill(0);
    this._weights.fill(0);
    if (!contacts || !n) return;
    const { count, side, rows, columns } = plane.restored;
    this.side = side;
    if (this._owners.length !== count) {
      this._owners = new Uint8Array(count);
      this._parts = new Uint16Array(count);
      this._queue = new Uint32Array(count);
      this.edges = new Uint16Array(16 * count);
    }
    this._owners.fill(0);
    const noise = CLEAR_DEVIATIONS * (frame.noise || 0) * (frame.noiseGain || 1);
    this._own(frame, plane, contacts.length > n ? contacts.slice(0, n) : contacts, noise);
    this._centre(frame.restored, plane);
    this._findEdges(rows, columns, marked);
  }

  /**
   * Give the cells that hang together to the contact that has their force and place; the others to the nearest of the
   * contacts that are left, as each may have moved or turned.
   * @param {Frame} frame
   * @param {Plane} plane
   * @param {Contact[]} contacts
   * @param {number} floor pressure that a cell exceeds
   */
  _own({ restored: values, unit = 0 }, { restored: { x, y, count, rows, columns, area }, pitch }, contacts, floor) {
    const { _owners: owners, _parts: parts, _queue: queue, _shapes: shapes } = this;
    parts.fill(0);
    for (let n = 0; n < contacts.length; n += 1) shape(contacts[n], shapes, n);
    for (let i = 0; i < count; i += 1) {
      if (!(values[i] > floor)) continue;
      const near = nearest(shapes, x[i], y[i], null);
      if (values[i] > PEAK_SHARE * contacts[near].peak) owners[i] = near + 1;
    }
    /** @type {Part[]} */
    const found = [];
    for (let first = 0; first < count; first += 1) {
      if (!owners[first] || parts[first]) continue;
      /** @type {Part} */
      const part = { force: 0, x: 0, y: 0, near: null, cut: false };
      found.push(part);
      parts[first] = found.length;
      queue[0] = first;
      for (let at = 0, end = 1; at < end; at += 1) {
        const i = queue[at];
        const force = values[i] * area[i] * FORCE_SCALES[unit];
        part.force += force;
        part.x += force * x[i];
        part.y += force * y[i];
        const column = i % columns;
        const row = (i - column) / columns;
        for (let r = Math.max(0, row - 1); r <= Math.min(rows - 1, row + 1); r += 1) {
          for (let c = Math.max(0, column - 1); c <= Math.min(columns - 1, column + 1); c += 1) {
            const beside = r * columns + c;
            if (Number.isNaN(values[beside]) && area[beside]) part.cut = true;
            if (!owners[beside] || parts[beside]) continue;
            parts[beside] = found.length;
            queue[end++] = beside;
          }
        }
      }
      part.x /= part.force;
      part.y /= part.force;
    }
    const owned = match(found, contacts, pitch);
    const left = this._left;
    left.clear();
    for (let n = 0; n < contacts.length; n += 1) if (!owned.includes(n)) left.add(n);
    for (let i = 0; i < count && left.size; i += 1) {
      if (!owners[i] || owned[parts[i] - 1] >= 0) continue;
      const near = nearest(shapes, x[i], y[i], left);
      if (distance(shapes, near, x[i], y[i]) <= WITHIN_DEVIATIONS) (found[parts[i] - 1].near ??= new Set()).add(near);
    }
    for (let i = 0; i < count; i += 1) {
      if (!owners[i]) continue;
      const part = parts[i] - 1;
      const { near, cut } = found[part];
      const own = owned[part] >= 0 ? owned[part] : near ? nearest(shapes, x[i], y[i], near) : -1;
      owners[i] = own < 0 || (cut && distance(shapes, own, x[i], y[i]) > WITHIN_DEVIATIONS) ? 0 : own + 1; // no contact is beside a hole
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

  /** @param {number} rows @param {number} columns @param {number} marked how many contacts have an outline */
  _findEdges(rows, columns, marked) {
    const { _owners: owners } = this;
    for (let row = 0; row < rows; row += 1) {
      for (let column = 0; column < columns; column += 1) {
        const i = row * columns + column;
        const owner = owners[i];
        if (!owner || owner > marked) continue;
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
