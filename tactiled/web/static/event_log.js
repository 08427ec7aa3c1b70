/** What happened to the service, newest first, with times. @module */

import * as api from "./api.js";
import { byId, element } from "./dom.js";

/** @import { Event } from "./api.js" */

const MAX_LINES = 100; // lines
const BAD_KINDS = new Set(["sensor_stale", "sensor_down", "bus_down", "warning_raised", "state_ignored", "fault_raised", "taxel_faulty", "config_refused"]);

export class EventLog {
  constructor() {
    this._list = byId("events");
    this._newest = 0;
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
    if (newest < this._newest) this._list.replaceChildren();
    this._newest = events.length ? events[events.length - 1].id : newest;
    for (const each of events) this._list.prepend(line(each));
    while (this._list.children.length > MAX_LINES) this._list.lastElementChild?.remove();
  }
}

/** @param {Event} event @returns {HTMLElement} */
function line(event) {
  const date = new Date(event.time * 1000);
  const time = element("time", "", date.toLocaleTimeString([], { hour12: false }));
  time.dateTime = date.toISOString();
  time.title = date.toLocaleString();
  const title = [event.sensor ?? event.bus, event.kind.replaceAll("_", " ")].filter(Boolean).join(": ");
  return element("li", BAD_KINDS.has(event.kind) ? "bad" : "", time, " ", element("b", "", title), ` ${event.text}`);
}
