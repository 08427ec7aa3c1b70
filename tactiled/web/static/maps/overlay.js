/**
 * What is marked on a map: contacts, the cross-section, the probe, saturated taxels.
 * Every mark is light on dark, so that it shows on any colour of the map and to every eye.
 * @module
 */

import { fitCanvas, context2d } from "../shell/dom.js";
import { ACROSS } from "./geometry.js";
import { SERIES } from "./region_layer.js";
import { SATURATED } from "../wire/wire.js";

/** @import { ContactOutline } from "./contact_outline.js" */
/** @import { Contact } from "../wire/sensor_stream.js" */
/** @import { Axis, Plane } from "./geometry.js" */
/** @import { Measures } from "./measures.js" */

/**
 * What is to be marked.
 * @typedef {object} Marks
 * @property {Axis} along what the cross-section runs along
 * @property {number} lineAt mm, where it crosses the other axis; NaN for none
 * @property {number} probeX mm; NaN for none
 * @property {number} probeY mm
 * @property {boolean} pinned
 * @property {Contact[]|null} contacts null where they are not to be shown
 * @property {boolean} centred the centre of pressure is marked where they are not
 * @property {Map<number, string>} labels of contacts by id, as the table has them
 * @property {Map<string, number>|null} slots of series by "contact 3": its label has the series' colour
 * @property {ContactOutline} outline of the contacts
 * @property {number} outlined number of the frame that the outlines are of
 * @property {readonly {x: number, y: number, wide: number}[]} names of regions, CSS px by their lower left corner: labels keep off them
 */

const OUTLINE_DEVIATIONS = 2; // standard deviations from the centre of a contact whose cells are not outlined to its rim
const CROSS_PX = 4; // CSS px, half of a centre's cross
const MIN_AXIS_PX = 6; // CSS px, the least half axis of an outline
const TEXT_PX = 12; // CSS px
const LINE_END_PX = 10; // CSS px, that is drawn of the cross-section's line at either side

export class Overlay {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this._pen = context2d(canvas);
    /** @type {Plane|null} */
    this._plane = null;
    this._ratio = 1;
    /** Device px per mm. */
    this._px = 1;
    this._family = getComputedStyle(document.body).fontFamily;
    this._font = "";
    /** @type {{x: number, y: number, half: number}[]} labels that are drawn already, device px */
    this._labels = [];
    /** What is drawn, but for crosses on saturated taxels; `known` is false where it must be redrawn. */
    this._last = {
      known: false, along: "", lineAt: NaN, probeX: NaN, probeY: NaN, ringX: NaN, ringY: NaN, pinned: false,
      contacts: /** @type {Contact[]|null} */ (null), labels: /** @type {Map<number, string>|null} */ (null), outlined: -1, names: /** @type {Marks["names"]|null} */ (null), slots: /** @type {Marks["slots"]} */ (null),
    };
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  resize(plane, zoom) {
    this._plane = plane;
    this._ratio = fitCanvas(this.canvas, plane.width * zoom, plane.height * zoom);
    this._px = zoom * this._ratio;
    this._font = `600 ${TEXT_PX * this._ratio}px ${this._family}`;
    this._last.known = false;
  }

  /** Show nothing. */
  clear() {
    this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this._labels.length = 0;
    this._last.known = false;
  }

  /**
   * Draw the marks where they are others than the last time, which of many frames they are not.
   * @param {Marks} marks
   * @param {Measures} measures of the map's image
   * @param {Uint8Array|null} flags of the raw image; null where nothing is saturated
   */
  draw(marks, measures, flags) {
    const plane = this._plane;
    if (!plane || this._same(marks, measures, flags !== null)) return;
    this._pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this._labels.length = 0;
    for (const { x, y, wide } of marks.names) {
      this._labels.push({ x: Math.round((x + wide / 2) * this._ratio), y: Math.round((y - TEXT_PX / 3) * this._ratio), half: Math.round((wide / 2 + 2) * this._ratio) });
    }
    if (flags) this._saturated(flags, plane);
    if (Number.isFinite(marks.lineAt)) this._line(marks, plane);
    if (marks.contacts) this._contacts(marks.contacts, marks, plane);
    else if (marks.centred && measures.contact) this._ring((measures.x - plane.left) * this._px, (measures.y - plane.top) * this._px, 6);
    if (!Number.isFinite(marks.probeX)) return;
    const x = (marks.probeX - plane.left) * this._px;
    const y = (marks.probeY - plane.top) * this._px;
    this._pen.beginPath();
    this._cross(x, y, 9 * this._ratio);
    this._twoTone(1.5);
    if (marks.pinned) this._ring(x, y, 4);
  }

  /**
   * @param {Marks} marks
   * @param {Measures} measures
   * @param {boolean} crossed taxels are
   * @returns {boolean} all that is drawn already; if not, it is taken down as drawn
   */
  _same(marks, measures, crossed) {
    const last = this._last;
    const ringed = !marks.contacts && marks.centred && measures.contact;
    const ringX = ringed ? measures.x : NaN;
    const ringY = ringed ? measures.y : NaN;
    if (last.known && !crossed && last.contacts === marks.contacts && last.labels === marks.labels && last.names === marks.names && last.slots === marks.slots && last.outlined === marks.outlined && last.pinned === marks.pinned
      && last.along === marks.along && Object.is(last.lineAt, marks.lineAt) && Object.is(last.ringX, ringX) && Object.is(last.ringY, ringY)
      && Object.is(last.probeX, marks.probeX) && Object.is(last.probeY, marks.probeY)) return true;
    last.known = !crossed;
    last.contacts = marks.contacts;
    last.labels = marks.labels;
    last.names = marks.names;
    last.slots = marks.slots;
    last.outlined = marks.outlined;
    last.pinned = marks.pinned;
    last.along = marks.along;
    last.lineAt = marks.lineAt;
    last.ringX = ringX;
    last.ringY = ringY;
    last.probeX = marks.probeX;
    last.probeY = marks.probeY;
    return false;
  }

  /** @param {Contact[]} contacts @param {Marks} marks @param {Plane} plane */
  _contacts(contacts, { outline, labels, slots }, plane) {
    const draw = this._pen;
    const minAxis = MIN_AXIS_PX * this._ratio;
    const { edges } = outline;
    const cell = outline.side * this._px;
    draw.lineCap = "round";
    draw.beginPath();
    for (let i = 0; i < 4 * outline.count; i += 4) {
      draw.moveTo(Math.round(edges[i] * cell), Math.round(edges[i + 1] * cell));
      draw.lineTo(Math.round(edges[i + 2] * cell), Math.round(edges[i + 3] * cell));
    }
    for (let i = 0; i < contacts.length; i += 1) {
      const each = contacts[i];
      if (!outline.cells[i]) continue; // it is not in this frame
      // Whole pixels: any other number that is handed to the browser is an object for the collector.
      const x = Math.round((outline.centres[2 * i] - plane.left) * this._px);
      const y = Math.round((outline.centres[2 * i + 1] - plane.top) * this._px);
      const major = Math.round(Math.max(minAxis, OUTLINE_DEVIATIONS * each.major_mm * this._px));
      const minor = Math.round(Math.max(minAxis, OUTLINE_DEVIATIONS * each.minor_mm * this._px));
      if (!outline.outlined[i]) {
        draw.moveTo(Math.round(x + major * Math.cos(each.angle_rad)), Math.round(y + major * Math.sin(each.angle_rad)));
        draw.ellipse(x, y, major, minor, each.angle_rad, 0, 2 * Math.PI);
      }
      this._cross(x, y, CROSS_PX * this._ratio);
    }
    this._twoTone(1.5);
    draw.font = this._font;
    draw.textBaseline = "middle";
    draw.textAlign = "center";
    draw.lineJoin = "round";
    for (let i = 0; i < contacts.length; i += 1) {
      if (!outline.cells[i]) continue;
      const { id } = contacts[i];
      draw.fillStyle = (slots?.size && SERIES[slots.get(`contact ${id}`) ?? -1]) || "#fff";
      this._label(contacts[i], labels.get(id) ?? "", outline, i, plane);
    }
  }

  /**
   * Write a contact's number and force above it, below it, beside it or on it: where there is room first; else its
   * number alone.
   * @param {Contact} contact
   * @param {string} label
   * @param {ContactOutline} outline
   * @param {number} i the contact's number in the outline
   * @param {Plane} plane
   */
  _label(contact, label, outline, i, plane) {
    const half = Math.round(this._pen.measureText(label).width / 2 + 3 * this._ratio);
    const rise = this._rise;
    const minAxis = MIN_AXIS_PX * this._ratio;
    const long = OUTLINE_DEVIATIONS * contact.major_mm * this._px;
    const short = OUTLINE_DEVIATIONS * contact.minor_mm * this._px;
    const cos = Math.cos(contact.angle_rad);
    const sin = Math.sin(contact.angle_rad);
    const wide = Math.round(Math.max(minAxis, Math.hypot(long * cos, short * sin)));
    const tall = Math.round(Math.max(minAxis, Math.hypot(long * sin, short * cos)));
    const { extents, outlined } = outline;
    const cell = outline.side * this._px;
    const x = Math.round((outline.centres[2 * i] - plane.left) * this._px);
    const y = Math.round((outline.centres[2 * i + 1] - plane.top) * this._px);
    const within = Math.max(half, Math.min(this.canvas.width - half, x));
    const west = outlined[i] ? Math.round(extents[4 * i] * cell) : x - wide;
    const north = outlined[i] ? Math.round(extents[4 * i + 1] * cell) : y - tall;
    const east = outlined[i] ? Math.round(extents[4 * i + 2] * cell) : x + wide;
    const south = outlined[i] ? Math.round(extents[4 * i + 3] * cell) : y + tall;
    if (this._place(label, within, north - rise, half, rise) || this._place(label, within, south + rise, half, rise)
      || this._place(label, east + half, y, half, rise) || this._place(label, west - half, y, half, rise)
      || this._place(label, within, Math.max(rise, north + rise), half, rise)) return;
    const number = `${contact.id}`;
    const narrow = Math.round(this._pen.measureText(number).width / 2 + this._ratio);
    const inside = Math.max(narrow, Math.min(this.canvas.width - narrow, x));
    if (this._place(number, inside, north - rise, narrow, rise)) return;
    this._place(number, inside, Math.max(rise, y - 2 * rise), narrow, rise);
  }

  /**
   * @param {string} text
   * @param {number} x device px, of its middle
   * @param {number} y
   * @param {number} half of its width
   * @param {number} rise half of its height
   * @returns {boolean} false, with nothing written, where it would leave the map or cover another label
   */
  _place(text, x, y, half, rise) {
    if (x < half || y < rise || x + half > this.canvas.width || y + rise > this.canvas.height) return false;
    if (this.isLabelled(x, y, half, rise)) return false;
    this._labels.push({ x, y, half });
    const draw = this._pen;
    const ink = draw.fillStyle;
    draw.fillStyle = "rgb(0 0 0 / 50%)"; // lines of regions run behind it
    draw.fillRect(x - half, y - rise, 2 * half, 2 * rise);
    draw.fillStyle = ink;
    draw.lineWidth = 3.5 * this._ratio;
    draw.strokeStyle = "rgb(0 0 0 / 85%)";
    draw.strokeText(text, x, y);
    draw.fillText(text, x, y);
    return true;
  }

  /** @returns {number} half of a label's height, device px */
  get _rise() {
    return Math.round((TEXT_PX / 2 + 2) * this._ratio);
  }

  /**
   * @param {number} x device px, of a text's middle
   * @param {number} y
   * @param {number} half of its width
   * @param {number} rise half of its height
   * @returns {boolean} a label is drawn there
   */
  isLabelled(x, y, half, rise) {
    const own = this._rise;
    for (let i = 0; i < this._labels.length; i += 1) {
      const each = this._labels[i];
      if (Math.abs(each.x - x) < each.half + half && Math.abs(each.y - y) < own + rise) return true;
    }
    return false;
  }

  /** @param {Uint8Array} flags @param {Plane} plane */
  _saturated(flags, plane) {
    const taxels = plane.raw;
    const half = Math.max(1.5 * this._ratio, Math.min(5 * this._ratio, 0.3 * taxels.side * this._px));
    const draw = this._pen;
    draw.beginPath();
    for (let i = 0; i < taxels.count; i += 1) {
      if (!(flags[i] & SATURATED)) continue;
      const x = (taxels.x[i] - plane.left) * this._px;
      const y = (taxels.y[i] - plane.top) * this._px;
      draw.moveTo(x - half, y - half);
      draw.lineTo(x + half, y + half);
      draw.moveTo(x - half, y + half);
      draw.lineTo(x + half, y - half);
    }
    this._twoTone(1.5);
  }

  /** Draw the cross-section's line, without a probe its ends alone: nobody asked for it. @param {Marks} marks @param {Plane} plane */
  _line({ along, lineAt, probeX }, plane) {
    const at = (lineAt - plane.start(ACROSS[along])) * this._px;
    const long = along === "x" ? this.canvas.width : this.canvas.height;
    const end = Number.isFinite(probeX) ? long / 2 : LINE_END_PX * this._ratio;
    this._pen.beginPath();
    this._stretch(along, at, 0, end);
    this._stretch(along, at, long - end, long);
    this._twoTone(1, "rgb(0 0 0 / 35%)", "rgb(255 255 255 / 65%)");
  }

  /** Add a stretch of a straight line to the path. @param {Axis} along @param {number} at device px @param {number} from @param {number} to */
  _stretch(along, at, from, to) {
    this._pen.moveTo(along === "x" ? from : at, along === "x" ? at : from);
    this._pen.lineTo(along === "x" ? to : at, along === "x" ? at : to);
  }

  /** @param {number} x device px @param {number} y @param {number} arm */
  _cross(x, y, arm) {
    const draw = this._pen;
    draw.moveTo(x, y - arm);
    draw.lineTo(x, y + arm);
    draw.moveTo(x - arm, y);
    draw.lineTo(x + arm, y);
  }

  /** @param {number} x device px @param {number} y @param {number} radius CSS px */
  _ring(x, y, radius) {
    this._pen.beginPath();
    this._pen.arc(x, y, radius * this._ratio, 0, 2 * Math.PI);
    this._twoTone(1.5);
  }

  /**
   * Stroke the path so that it shows on any colour.
   * @param {number} width CSS px
   * @param {string} under
   * @param {string} over
   */
  _twoTone(width, under = "rgb(0 0 0 / 80%)", over = "#fff") {
    const draw = this._pen;
    draw.lineWidth = (width + 2) * this._ratio;
    draw.strokeStyle = under;
    draw.stroke();
    draw.lineWidth = width * this._ratio;
    draw.strokeStyle = over;
    draw.stroke();
  }
}
