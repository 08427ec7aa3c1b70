/** A film of what is seen of the maps, as a WebM file. @module */

import { byId, setText } from "../shell/dom.js";
import { download } from "./download.js";
import { notice } from "../shell/notice.js";

/** @import { Frame } from "../wire/frame_history.js" */

const RATE_HZ = 30; // of the film
const MAX_S = 600;
const BITS_PER_S = 8e6;
const KINDS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];

export class Film {
  /** @param {() => {sensor: string, frame: Frame, picture: HTMLCanvasElement}|null} take a picture of what is seen */
  constructor(take) {
    this._take = take;
    this._canvas = document.createElement("canvas");
    /** @type {MediaRecorder|null} */
    this._recorder = null;
    this._drawnAt = this._beganAt = -Infinity; // ms
  }

  /** @returns {boolean} */
  get runs() {
    return this._recorder !== null;
  }

  /** Begin with what is seen. @returns {boolean} it has begun */
  begin() {
    const kind = "MediaRecorder" in window ? KINDS.find((each) => MediaRecorder.isTypeSupported(each)) : undefined;
    const first = this._take();
    if (!first) return false;
    if (!kind) {
      notice("This browser records no films.", true);
      return false;
    }
    const { sensor, frame, picture } = first;
    this._canvas.width = picture.width;
    this._canvas.height = picture.height;
    this._draw(picture);
    /** @type {Blob[]} */
    const parts = [];
    this._recorder = new MediaRecorder(this._canvas.captureStream(RATE_HZ), { mimeType: kind, videoBitsPerSecond: BITS_PER_S });
    this._recorder.ondataavailable = ({ data }) => parts.push(data);
    this._recorder.onstop = () => download(sensor, frame, "webm", new Blob(parts, { type: "video/webm" }));
    this._recorder.start();
    this._drawnAt = this._beganAt = performance.now();
    this._show();
    return true;
  }

  /** Something else was painted. @param {number} now ms */
  painted(now) {
    if (!this.runs || now - this._drawnAt < 900 / RATE_HZ) return;
    this._drawnAt = now;
    const taken = this._take();
    if (taken) this._draw(taken.picture);
    if (!taken || now - this._beganAt > 1000 * MAX_S) this.end();
  }

  /** Save it. */
  end() {
    this._recorder?.stop();
    this._recorder = null;
    this._show();
  }

  /** @param {HTMLCanvasElement} picture */
  _draw(picture) {
    const pen = /** @type {CanvasRenderingContext2D} */ (this._canvas.getContext("2d", { alpha: false }));
    pen.drawImage(picture, 0, 0);
  }

  _show() {
    setText(byId("film"), this.runs ? "End film" : "Film");
    byId("film").setAttribute("aria-pressed", String(this.runs));
  }
}
