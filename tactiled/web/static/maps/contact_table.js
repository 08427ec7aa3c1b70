/** The contacts as a table: what the outlines on the maps say, in numbers. @module */

import { element, setText } from "../shell/dom.js";
import { number } from "../shell/format.js";
import { forceNumber, forceSpread, lengthNumber } from "../shell/units.js";

/** @import { Contact } from "../wire/sensor_stream.js" */

export const MAX_ROWS = 6; // contacts, the strongest: the maps mark no more
const COLUMNS = 6;
const LATE_MS = 2000; // that contacts of a busy service may be late by
const DEVIATIONS = 2; // that are shown of a force

export class ContactTable {
  /** @param {HTMLElement} root that holds the table and the line for where there is nothing to list */
  constructor(root) {
    this._body = /** @type {HTMLTableSectionElement} */ (root.querySelector("tbody"));
    this._table = /** @type {HTMLTableElement} */ (root.querySelector("table"));
    this._line = /** @type {HTMLElement} */ (root.querySelector("p"));
    this._known = -Infinity; // ms, when contacts were last shown
  }

  /**
   * @param {Contact[]|null} contacts null where none are known
   * @param {boolean} enabled whether they are requested
   * @param {string} held what is shown in place of an image; "" for nothing
   * @param {string} none what it means that there are none
   * @param {number} unit of their pressure
   * @param {boolean} still the frame does not change: no contacts are on their way
   * @param {Map<string, number>|null} charted what the chart of series shows, as "contact 3"; null where it can show none
   */
  show(contacts, enabled, held, none, unit, still, charted) {
    const now = performance.now();
    if (contacts) this._known = now;
    const late = !contacts && enabled && !held && !still && now - this._known < LATE_MS;
    this._table.classList.toggle("late", late);
    if (late) return; // the rows stay, as old ones: nothing below them jumps
    const count = Math.min(MAX_ROWS, contacts?.length ?? 0);
    this._table.hidden = !count;
    this._line.hidden = count > 0 && (contacts?.length ?? 0) === count;
    const more = (contacts?.length ?? 0) - count;
    const unknown = held ? "Contacts are found in single images, not in this one." : still ? "No frame near this one was searched for contacts." : "–";
    setText(this._line, count ? `and ${more} weaker` : !enabled ? "Contacts are switched off." : contacts ? none : unknown);
    while (this._body.rows.length < count) this._body.append(newRow());
    while (this._body.rows.length > count) this._body.deleteRow(-1);
    for (let i = 0; contacts && i < count; i += 1) fillRow(this._body.rows[i].cells, contacts[i], unit, charted);
  }
}

/** @returns {HTMLTableRowElement} an empty one */
function newRow() {
  const button = element("button", "link");
  button.type = "button";
  button.title = "Draw its series, or remove it from the chart";
  const head = element("th", "", button);
  head.scope = "row";
  return element("tr", "", head, ...Array.from({ length: COLUMNS - 1 }, () => element("td", "")));
}

/** @param {HTMLCollectionOf<HTMLTableCellElement>} cells @param {Contact} contact @param {number} unit @param {Map<string, number>|null} charted */
function fillRow(cells, contact, unit, charted) {
  const button = /** @type {HTMLButtonElement} */ (cells[0].firstElementChild);
  setText(button, String(contact.id));
  button.disabled = !charted;
  button.setAttribute("aria-pressed", String(charted?.has(`contact ${contact.id}`) ?? false));
  const spread = contact.force_deviation == null ? "" : ` ± ${forceSpread(DEVIATIONS * contact.force_deviation, unit)}`;
  setText(cells[1], (contact.cut_off ? "≥ " : "") + forceNumber(contact.force, unit) + spread);
  setText(cells[2], number(contact.peak));
  setText(cells[3], number(contact.area_mm2));
  setText(cells[4], lengthNumber(contact.x_mm));
  setText(cells[5], lengthNumber(contact.y_mm));
}
