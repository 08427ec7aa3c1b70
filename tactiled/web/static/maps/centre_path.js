/** The way of the centre of pressure over the last seconds, on a map. @module */

import { context2d, fitCanvas } from "../shell/dom.js";

/** @import { FrameHistory } from "../wire/frame_history.js" */
/** @import { Plane } from "./geometry.js" */

const SPAN_S = 5;
const MAX_GAP_S = 0.5; // between two frames that the line joins

export class CentrePath {
  /** @param {HTMLElement} frame of the map @param {"ofRaw"|"ofRestored"} of which image's centre */
  constructor(frame, of) {
    this._canvas = document.createElement("canvas");
    this._canvas.className = "marks";
    this._canvas.setAttribute("aria-hidden", "true");
    frame.querySelector("canvas")?.after(this._canvas);
    this._pen = context2d(this._canvas);
    this._of = of;
    this._px = this._ratio = 1;
    this._empty = true;
  }

  /** @param {Plane} plane @param {number} zoom CSS px per mm */
  resize(plane, zoom) {
    this._ratio = fitCanvas(this._canvas, plane.width * zoom, plane.height * zoom);
    this._px = zoom * this._ratio;
  }

  clear() {
    if (!this._empty) this._pen.clearRect(0, 0, this._canvas.width, this._canvas.height);
    this._empty = true;
  }

  /** @param {FrameHistory} history @param {number} back which frame is shown @param {Plane} plane */
  draw(history, back, plane) {
    this.clear();
    const newest = history.at(back);
    if (!newest) return;
    const draw = this._pen;
    draw.beginPath();
    let time = NaN; // of the frame that the line has reached
    let down = false;
    for (let at = back, frame = history.at(at); frame; frame = history.at(at += 1)) {
      if (frame.timestamp <= newest.timestamp - SPAN_S || frame.timestamp > time || time - frame.timestamp > MAX_GAP_S) break;
      const { x, y } = frame[this._of];
      const known = x === x;
      const [left, top] = [(x - plane.left) * this._px, (y - plane.top) * this._px];
      if (known && down) draw.lineTo(left, top);
      else if (known) draw.moveTo(left, top);
      down = known;
      time = frame.timestamp;
    }
    draw.lineJoin = draw.lineCap = "round";
    for (const [width, color] of /** @type {const} */ ([[4, "rgb(0 0 0 / 70%)"], [2, "#7df3ff"]])) {
      draw.lineWidth = width * this._ratio;
      draw.strokeStyle = color;
      draw.stroke();
    }
    this._empty = false;
  }
}
