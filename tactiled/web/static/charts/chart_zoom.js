/** Zooming and panning of a large chart: by wheel and pointer on it, and by buttons. @module */

import { PLOT_LEFT_PX, PLOT_RIGHT_PX } from "./chart.js";
import { element } from "../shell/dom.js";

const STEP = 1.5; // by which a button zooms
const WHEEL_STEP = 0.0015; // of the logarithm of the zoom, for each px that a wheel turns
const PAN_SHARE = 0.5; // of the window, by which a button pans
const SLIP_PX = 4; // that a click may move

/** @typedef {{zoom: (factor: number, share?: number) => void, pan: (share: number) => void, reset: () => void}} Zoomed */

/**
 * Let a chart be zoomed where its panel is large.
 * @param {HTMLElement} canvas of the chart
 * @param {() => Zoomed} target the window that it shows now
 */
export function zoomable(canvas, target) {
  const panel = /** @type {HTMLElement} */ (canvas.closest(".panel"));
  const isLarge = () => panel.classList.contains("large");
  const width = () => canvas.clientWidth - PLOT_LEFT_PX - PLOT_RIGHT_PX;
  canvas.addEventListener("wheel", (event) => {
    if (!isLarge()) return;
    event.preventDefault();
    const share = Math.max(0, Math.min(1, (event.offsetX - PLOT_LEFT_PX) / width()));
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) target().pan(event.deltaX / width());
    else target().zoom(Math.exp(-WHEEL_STEP * event.deltaY), share);
  }, { passive: false });
  let [from, moved] = [NaN, 0]; // px
  canvas.addEventListener("pointerdown", (event) => {
    moved = 0;
    from = isLarge() && event.button === 0 ? event.clientX : NaN;
  });
  canvas.addEventListener("pointermove", (event) => {
    if (Number.isNaN(from)) return;
    const by = event.clientX - from;
    moved += Math.abs(by);
    if (moved <= SLIP_PX) return;
    if (!canvas.hasPointerCapture(event.pointerId)) canvas.setPointerCapture(event.pointerId);
    target().pan(-by / width());
    from = event.clientX;
  });
  for (const kind of /** @type {const} */ (["pointerup", "pointercancel"])) canvas.addEventListener(kind, () => { from = NaN; });
  canvas.addEventListener("click", (event) => moved > SLIP_PX && event.stopImmediatePropagation(), { capture: true });
  canvas.addEventListener("dblclick", () => isLarge() && target().reset());
  canvas.before(buttons(target));
}

/** @param {() => Zoomed} target @returns {HTMLElement} */
function buttons(target) {
  const all = /** @type {const} */ ([
    ["−", "Zoom out", () => target().zoom(1 / STEP)], ["+", "Zoom in", () => target().zoom(STEP)],
    ["◂", "To the left", () => target().pan(-PAN_SHARE)], ["▸", "To the right", () => target().pan(PAN_SHARE)], ["↺", "Show all", () => target().reset()],
  ]);
  return element("p", "zoom", ...all.map(([sign, title, action]) => {
    const button = element("button", "icon", sign);
    button.type = "button";
    button.title = title;
    button.setAttribute("aria-label", title);
    button.addEventListener("click", action);
    return button;
  }));
}
