/** Where something touches, as the stream tells it, kept as long as the frames are. @module */

import { newtons } from "./format.js";
import { Timeline } from "./timeline.js";

/**
 * One contact as the service tells it, with what is written beside it.
 * @typedef {object} Contact
 * @property {number} id the same while the contact lasts
 * @property {number} x_mm
 * @property {number} y_mm
 * @property {number} force_n
 * @property {number} area_mm2
 * @property {number} peak_kpa
 * @property {number} major_mm standard deviation of the pressure along the longer axis
 * @property {number} minor_mm
 * @property {number} angle_rad of the longer axis, from x towards y
 * @property {string} label its number and force; set where it is kept
 */

/**
 * The stream's message on one image's contacts.
 * @typedef {object} Found
 * @property {"contacts"} type
 * @property {number} sequence
 * @property {number} timestamp Unix s, of the frame
 * @property {Contact[]} contacts the strongest first
 */

const KEPT = 256; // messages: more than ten seconds at twenty a second
const HOLDS_S = 0.25; // between the frame that contacts are of and one that they are drawn on

/** @extends {Timeline<Found>} */
export class Contacts extends Timeline {
  constructor() {
    super(KEPT, HOLDS_S);
  }

  /** @override @param {Found} found */
  push(found) {
    for (const each of found.contacts) each.label = `${each.id}: ${newtons(each.force_n)} N`;
    super.push(found);
  }
}
