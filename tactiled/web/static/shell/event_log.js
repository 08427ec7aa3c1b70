/** What happened to the service, newest first, with times. @module */

import * as api from "../wire/api.js";
import { byId, element } from "./dom.js";
import { addEvent } from "./event_rows.js";

/** @import { Row } from "./event_rows.js" */

const BAD_KINDS = new Set(["sensor_stale", "sensor_down", "bus_down", "warning_raised", "state_ignored", "fault_raised", "taxel_faulty", "config_refused"]);

export class EventLog {
  constructor() {
    this._list = byId("events");
    this._newest = 0;
    /** @type {Row[]} newest first */
    this._rows = [];
    this.offered = false;
  }

  /** @param {boolean} offered whether the service has events */
  offer(offered) {
    this.offered = offered;
    byId("log").hidden = !offered;
  }

  /** Fetch what happened since the last look. */
  async update() {
    if (!this.offered) return;
    const { events, newest } = await api.events(this._newest);
    if (newest < this._newest) this._rows.length = 0;
    this._newest = events.length ? events[events.length - 1].id : newest;
    for (const each of events) addEvent(this._rows, each);
    if (events.length) this._list.replaceChildren(...this._rows.map(line));
  }
}

/** @param {number} time Unix s @returns {string} */
const clockTime = (time) => new Date(time * 1000).toLocaleTimeString([], { hour12: false });

/** @param {Row} row @returns {HTMLElement} */
function line({ event, count, since, begun }) {
  const date = new Date(event.time * 1000);
  const time = element("time", "", clockTime(event.time));
  time.dateTime = date.toISOString();
  time.title = date.toLocaleString();
  const title = [event.sensor ?? event.bus, event.kind.replaceAll("_", " ")].filter(Boolean).join(": ");
  const times = count > 1 ? ` × ${count} since ${clockTime(since)}` : "";
  const from = begun < event.time ? ` (from ${clockTime(begun)})` : "";
  return element("li", BAD_KINDS.has(event.kind) ? "bad" : "", time, " ", element("b", "", title), `${times}: ${event.text}${from}`);
}
