/** The measures of each contact over the last ten minutes, as the stream reports them. @module */

import { FORCE_SCALES, UNITS, unitOf } from "../shell/units.js";

/** @import { Series } from "../wire/api.js" */
/** @import { ContactsMessage } from "../wire/sensor_stream.js" */

const SERIES_S = 600;
const MAX_ROWS = 96_000; // 6 MB: eight contacts at twenty messages a second; of more contacts the time is shorter
const MAX_CONTACTS = 1000; // that are listed
const ROW = 8; // time, number of the message, id, force, peak, area, x, y
const GONE_AFTER_S = 0.2; // after which a contact has ended, unless it comes back

export class ContactSeries {
  /** @param {number} [capacity] rows: contacts times messages */
  constructor(capacity = MAX_ROWS) {
    this._capacity = capacity;
    this._rows = new Float64Array(capacity * ROW); // a ring
    this._count = 0; // rows so far
    this._messages = 0;
    /** @type {Map<number, number>} Unix s, when each contact came last */
    this._times = new Map();
    /** Unix s, of the newest message; NaN before the first. */
    this.newest = NaN;
    /** Of all pressures, index in UNITS. */
    this.unit = 0;
  }

  /** @param {ContactsMessage} message one of another unit, or of an earlier time, begins a new series */
  push({ timestamp, unit, contacts }) {
    if (timestamp === this.newest) return;
    if (unitOf(unit) !== this.unit || timestamp < this.newest) {
      this._count = 0;
      this._times.clear();
    }
    this.unit = unitOf(unit);
    this.newest = timestamp;
    this._messages += 1;
    for (const { id, force, peak, area_mm2, x_mm, y_mm } of contacts) {
      this._rows.set([timestamp, this._messages, id, force, peak, area_mm2, x_mm, y_mm], (this._count % this._capacity) * ROW);
      this._count += 1;
      this._times.set(id, timestamp);
      if (this._times.size > MAX_CONTACTS) this._times.delete(/** @type {number} */ (this._times.keys().next().value));
    }
  }

  /** @returns {{id: number, ended: boolean}[]} the contacts of the last ten minutes, newest first */
  get contacts() {
    const { newest } = this;
    const recent = [...this._times].filter(([, time]) => time >= newest - SERIES_S).sort(([a], [b]) => b - a);
    return recent.map(([id, time]) => ({ id, ended: newest - time > GONE_AFTER_S }));
  }

  /**
   * @param {number} id of a contact
   * @param {number} seconds before the newest message, or before `until`
   * @param {number|null} until Unix s; null: go on to the newest
   * @returns {Series} with null where a message came without it, so that no line goes on there; mean is force over area
   */
  of(id, seconds, until = null) {
    /** @type {Required<Series>} */
    const series = { unit: UNITS[this.unit], time: [], force: [], mean: [], peak: [], area: [], x: [], y: [] };
    const { _rows: rows, _capacity: capacity, newest } = this;
    const oldest = Math.max(0, this._count - capacity);
    let first = this._count;
    while (first > oldest && rows[((first - 1) % capacity) * ROW] >= (until ?? newest) - seconds) first -= 1;
    let message = 0;
    for (let i = first; i < this._count && rows[(i % capacity) * ROW] <= (until ?? newest); i += 1) {
      const at = (i % capacity) * ROW;
      if (rows[at + 2] !== id) continue;
      if (message && rows[at + 1] > message + 1) add(series, rows[at], null, null, null, null, null, null);
      message = rows[at + 1];
      const [force, area] = [rows[at + 3], rows[at + 5]];
      add(series, rows[at], force, force / (FORCE_SCALES[this.unit] * area), rows[at + 4], area, rows[at + 6], rows[at + 7]);
    }
    return series;
  }
}

/** @typedef {number|null} Value */

/** @param {Required<Series>} to @param {number} time @param {Value} force @param {Value} mean @param {Value} peak @param {Value} area @param {Value} x @param {Value} y */
function add(to, time, force, mean, peak, area, x, y) {
  to.time.push(time);
  to.force.push(force);
  to.mean.push(mean);
  to.peak.push(peak);
  to.area.push(area);
  to.x.push(x);
  to.y.push(y);
}
