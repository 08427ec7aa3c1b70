/** The regions' outlines on a map, and the one that is being drawn. @module */

import { context2d, fitCanvas } from "../shell/dom.js";

/** @import { Plane } from "./geometry.js" */
/** @import { Shape } from "../wire/api.js" */

const TEXT_PX = 12; // CSS px
const HANDLE_PX = 5; // radius

/** Of series by slot, as style.css has them for a dark page: maps are dark. */
export const SERIES = ["#56b4e9", "#ff9d5c", "#19a87c", "#e8a0cc", "#e7edf3", "#f0d24c"];

/** @typedef {{name: string, shape: Shape, points_mm: [number, number][], exceeded: boolean, slot?: number}} Outline of a region; `slot` is of its series */

export class RegionLayer {
  /** @param {HTMLElement} frame of the map */
  constructor(frame) {
    this._canvas = layer();
    this._names = layer();
    frame.querySelector("canvas")?.after(this._canvas); // under the labels of contacts
    frame.append(this._names); // over the outlines of contacts
    /** @type {Plane|null} */
    this._plane = null;
    this._zoom = 1;
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  resize(plane, zoom) {
    this._plane = plane;
    this._zoom = zoom;
  }

  /** @param {Outline[]} outlines @returns {Place[]} of their names */
  draw(outlines) {
    const plane = this._plane;
    if (!plane) return [];
    const zoom = this._zoom;
    const ratio = fitCanvas(this._canvas, plane.width * zoom, plane.height * zoom);
    const draw = context2d(this._canvas);
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.clearRect(0, 0, plane.width * zoom, plane.height * zoom);
    draw.lineJoin = "round";
    const labels = [];
    for (const { name, shape, points_mm, exceeded, slot } of outlines) {
      const color = SERIES[slot ?? -1] ?? (exceeded ? "#ffb454" : "#fff");
      const points = points_mm.map(([x, y]) => [(x - plane.left) * zoom, (y - plane.top) * zoom]);
      const xs = points.map((each) => each[0]);
      const ys = points.map((each) => each[1]);
      const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
      draw.beginPath();
      outline(draw, shape, points, left, top, right - left, bottom - top);
      for (const [width, stroke] of /** @type {const} */ ([[3.5, "rgb(0 0 0 / 80%)"], [1.5, color]])) {
        draw.setLineDash(width > 2 || exceeded ? [] : [6, 3]);
        draw.lineWidth = width;
        draw.strokeStyle = stroke;
        draw.stroke();
      }
      draw.setLineDash([]);
      if (!name && shape === "polygon") drawHandle(draw, points[0]);
      if (!name) continue;
      const [low, high] = { rectangle: [], ellipse: Array(2).fill((left + right) / 2), polygon: [bottom, top].map((y) => xs[ys.indexOf(y)]) }[shape];
      labels.push({ name: exceeded ? `▲ ${name}` : name, color, left, top, bottom, low, high });
    }
    return this._label(labels, plane.width * zoom, plane.height * zoom);
  }

  /** @param {Name[]} names @param {number} width px, of the map @param {number} height px @returns {Place[]} */
  _label(names, width, height) {
    const ratio = fitCanvas(this._names, width, height);
    const draw = context2d(this._names);
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.clearRect(0, 0, width, height);
    draw.font = `600 ${TEXT_PX}px ${getComputedStyle(document.body).fontFamily}`;
    draw.lineJoin = "round";
    draw.lineWidth = 3;
    draw.strokeStyle = "rgb(0 0 0 / 80%)";
    const places = placeNames(names, width, height, (text) => draw.measureText(text).width);
    for (const { name, color, x, y } of places) {
      draw.fillStyle = color;
      draw.strokeText(name, x, y);
      draw.fillText(name, x, y);
    }
    return places;
  }
}

/** @returns {HTMLCanvasElement} */
function layer() {
  const canvas = document.createElement("canvas");
  canvas.className = "marks";
  canvas.setAttribute("aria-hidden", "true");
  return canvas;
}

/**
 * Name of a region that is there, px; `low` and `high` are x of the lowest and highest place of what is no rectangle.
 * @typedef {{name: string, color: string, left: number, top: number, bottom: number, low?: number, high?: number}} Name
 */
/** @typedef {Name & {x: number, y: number, wide: number}} Place by its lower left corner */

/**
 * Place each name below its region, as labels of contacts are above them; else above or in it.
 * @param {Name[]} names
 * @param {number} width px, of the map
 * @param {number} height px
 * @param {(text: string) => number} widthOf a text, px
 * @returns {Place[]} those that are on the map and over no other
 */
export function placeNames(names, width, height, widthOf) {
  /** @type {Place[]} */
  const placed = [];
  for (const each of names) {
    const { left, top, bottom } = each;
    const wide = widthOf(each.name);
    const [low, high] = [each.low, each.high].map((at) => Math.max(2, Math.min(width - wide - 2, at === undefined ? left + 2 : at - wide / 2)));
    const free = (/** @type {number[]} */ [x, y]) => y >= TEXT_PX && y <= height - 4
      && placed.every((other) => Math.abs(other.y - y) > TEXT_PX || other.x > x + wide || x > other.x + other.wide);
    const place = [[low, bottom + TEXT_PX + 1], [high, top - 4], [high, top + TEXT_PX + 2], [low, bottom - 4], [low, (top + bottom) / 2]].find(free);
    if (place) placed.push({ ...each, x: place[0], y: place[1], wide });
  }
  return placed;
}

/** Mark the corner at which a polygon is closed. @param {CanvasRenderingContext2D} draw @param {number[]} place px */
function drawHandle(draw, [x, y]) {
  draw.beginPath();
  draw.arc(x, y, HANDLE_PX, 0, 2 * Math.PI);
  draw.fillStyle = "#fff";
  draw.fill();
  draw.lineWidth = 2;
  draw.strokeStyle = "rgb(0 0 0 / 80%)";
  draw.stroke();
}

/**
 * @param {CanvasRenderingContext2D} draw
 * @param {Shape} shape
 * @param {number[][]} points px
 * @param {number} left px, of the box round it
 * @param {number} top
 * @param {number} width
 * @param {number} height
 */
function outline(draw, shape, points, left, top, width, height) {
  if (shape === "rectangle") draw.rect(left, top, width, height);
  else if (shape === "ellipse") draw.ellipse(left + width / 2, top + height / 2, width / 2, height / 2, 0, 0, 2 * Math.PI);
  else {
    for (const [x, y] of points) draw.lineTo(x, y);
    draw.closePath();
  }
}
