/** Axes of a map in mm, left of it and below it. @module */

import { context2d, fitCanvas, themeColors } from "../shell/dom.js";
import { labelledTicks } from "../charts/ticks.js";

/** @import { ThemeColors } from "../shell/dom.js" */
/** @import { Plane } from "./geometry.js" */

export const AXIS_LEFT_PX = 30; // CSS px beside a map; style.css has the same,
export const AXIS_BOTTOM_PX = 20; // and below it
const [TICK_PX, HALF_TEXT_PX] = [4, 6];
const GAP_PX = 50; // between two ticks, at least, of either axis

/**
 * Draw the axes of a map.
 * @param {CanvasRenderingContext2D} draw
 * @param {Plane} plane
 * @param {number} zoom px per mm
 * @param {number} left px, of the map
 * @param {number} top px, of the map
 * @param {ThemeColors} ink
 */
export function drawAxes(draw, plane, zoom, left, top, ink) {
  const width = plane.width * zoom;
  const bottom = top + plane.height * zoom;
  draw.font = `11px ${ink.font}`;
  draw.fillStyle = draw.strokeStyle = ink.muted;
  draw.lineWidth = 1;
  draw.beginPath();
  draw.textAlign = "center";
  draw.textBaseline = "top";
  for (const { value, text } of labelledTicks(plane.left, plane.left + plane.width, width / GAP_PX)) {
    const x = Math.round(left + (value - plane.left) * zoom) + 0.5;
    draw.moveTo(x, bottom);
    draw.lineTo(x, bottom + TICK_PX);
    const half = draw.measureText(text).width / 2;
    draw.fillText(text, Math.max(left + half, Math.min(x, left + width - half)), bottom + TICK_PX + 2);
  }
  draw.textAlign = "right";
  draw.textBaseline = "middle";
  for (const { value, text } of labelledTicks(plane.top, plane.top + plane.height, (bottom - top) / GAP_PX)) {
    const y = Math.round(top + (value - plane.top) * zoom) + 0.5;
    draw.moveTo(left - TICK_PX, y);
    draw.lineTo(left, y);
    draw.fillText(text, left - TICK_PX - 2, Math.max(y, top + HALF_TEXT_PX));
  }
  draw.textBaseline = "top";
  draw.fillText("mm", left - TICK_PX - 4, bottom + TICK_PX + 2);
  draw.stroke();
  draw.textAlign = "left";
  draw.textBaseline = "alphabetic";
}

export class MapAxes {
  /** @param {HTMLElement} frame of the map, in its box */
  constructor(frame) {
    this._canvas = document.createElement("canvas");
    this._canvas.className = "axes";
    this._canvas.setAttribute("aria-hidden", "true");
    frame.before(this._canvas);
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  draw(plane, zoom) {
    const width = AXIS_LEFT_PX + plane.width * zoom;
    const height = plane.height * zoom + AXIS_BOTTOM_PX;
    const ratio = fitCanvas(this._canvas, width, height);
    this._canvas.style.width = `${width}px`;
    this._canvas.style.height = `${height}px`;
    const draw = context2d(this._canvas);
    draw.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw.clearRect(0, 0, width, height);
    drawAxes(draw, plane, zoom, AXIS_LEFT_PX, 0, themeColors());
  }
}
