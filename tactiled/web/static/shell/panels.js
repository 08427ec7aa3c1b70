/** Where the panels stand, how large they are, and which are folded; the browser keeps it. @module */

import { byId, element } from "./dom.js";
import { loadSetting, saveSetting } from "./storage.js";

const KEY = "tactiled.panels";
const BESIDE_FROM_PX = 1700; // CSS px, of a window in which maps lose nothing to panels beside them

const STEP_PX = 16; // by which a key moves an edge
const WIDTHS = /** @type {const} */ ([280, 900]); // CSS px, of panels beside the maps
const HEIGHTS = /** @type {const} */ ([120, 700]); // of a chart

/** @typedef {{beside: boolean, folded: string[], large: string[], width: number|null, heights: Record<string, number>}} Kept */

export class Panels {
  /** @param {() => void} onChange */
  constructor(onChange) {
    this._onChange = onChange;
    /** Of panels; null and none: as the page has it. @type {Kept} */
    this._kept = { beside: window.innerWidth >= BESIDE_FROM_PX, folded: [], large: [], width: null, heights: {}, ...kept() };
    this._place = byId("panels-place");
    this._place.addEventListener("click", () => {
      this._kept.beside = !this._kept.beside;
      this._show();
    });
    for (const panel of document.querySelectorAll("#side > .panel")) {
      const title = panel.querySelector("h2");
      if (!title) continue;
      const buttons = element("span", "panel-buttons");
      if (panel.querySelector(":scope > canvas, #plot-chart")) buttons.append(this._button(panel, title, "large", "⤢", "Enlarge"));
      buttons.append(this._button(panel, title, "folded", "", "Fold"));
      panel.append(buttons);
      if (panel.querySelector(":scope > canvas, #plot-chart")) panel.append(this._heightGrip(/** @type {HTMLElement} */ (panel), title));
    }
    byId("main").append(this._widthGrip());
    this._showPlace();
  }

  /**
   * @param {Element} panel
   * @param {Element} title
   * @param {"folded"|"large"} kind
   * @param {string} sign
   * @param {string} verb
   * @returns {HTMLButtonElement} which sets and clears what the panel is
   */
  _button(panel, title, kind, sign, verb) {
    const button = element("button", `icon ${kind}-button`, sign);
    button.type = "button";
    const show = () => {
      const is = this._kept[kind].includes(title.id);
      panel.classList.toggle(kind, is);
      button.setAttribute("aria-pressed", String(is));
    };
    button.title = verb;
    button.setAttribute("aria-label", `${verb} ${nameOf(title)}`);
    button.addEventListener("click", () => {
      const others = this._kept[kind].filter((each) => each !== title.id);
      this._kept[kind] = others.length < this._kept[kind].length ? others : [...others, title.id];
      show();
      this._show();
      if (panel.classList.contains("large")) panel.scrollIntoView({ block: "nearest" });
    });
    show();
    return button;
  }

  /** @param {HTMLElement} panel @param {Element} title @returns {HTMLElement} the edge that makes its chart higher */
  _heightGrip(panel, title) {
    const { heights } = this._kept;
    const canvas = /** @type {HTMLElement} */ (panel.querySelector(":scope > canvas, #plot-chart"));
    const show = () => {
      if (heights[title.id]) panel.style.setProperty("--chart", `${heights[title.id]}px`);
    };
    show();
    return grip("y", `Height of ${nameOf(title)}`, HEIGHTS, () => canvas.clientHeight, (height) => {
      heights[title.id] = height;
      show();
      this._show();
    });
  }

  /** @returns {HTMLElement} the edge between maps and panels beside them */
  _widthGrip() {
    const show = () => {
      if (this._kept.width) byId("main").style.setProperty("--side-px", `${this._kept.width}px`);
    };
    show();
    return grip("x", "Width of the panels", WIDTHS, () => byId("side").clientWidth, (width) => {
      this._kept.width = width;
      show();
      this._show();
    });
  }

  _show() {
    saveSetting(KEY, JSON.stringify(this._kept));
    this._showPlace();
    this._onChange();
  }

  _showPlace() {
    const { beside } = this._kept;
    document.body.classList.toggle("beside", beside);
    const label = `Panels: put them ${beside ? "below" : "beside"} the maps`;
    this._place.setAttribute("aria-label", label);
    this._place.title = label;
  }
}

/** @param {Element} title @returns {string} what stands in it before any other element */
const nameOf = (title) => title.firstChild?.textContent?.trim() || title.textContent || "";

/**
 * @param {"x"|"y"} along where it is moved
 * @param {string} label
 * @param {readonly [number, number]} bounds CSS px
 * @param {() => number} size CSS px, now
 * @param {(size: number) => void} resize
 * @returns {HTMLElement} an edge that pointer and arrow keys move: to the left, or down, for more
 */
function grip(along, label, [least, most], size, resize) {
  const edge = element("div", `grip along-${along}`);
  edge.tabIndex = 0;
  edge.setAttribute("role", "separator");
  edge.setAttribute("aria-orientation", along === "x" ? "vertical" : "horizontal");
  edge.setAttribute("aria-label", label);
  edge.setAttribute("aria-valuemin", String(least));
  edge.setAttribute("aria-valuemax", String(most));
  edge.setAttribute("aria-valuenow", String(least));
  const set = (/** @type {number} */ to) => {
    const bounded = Math.round(Math.max(least, Math.min(most, to)));
    edge.setAttribute("aria-valuenow", String(bounded));
    resize(bounded);
  };
  const place = (/** @type {PointerEvent} */ event) => (along === "x" ? -event.clientX : event.clientY);
  let from = 0; // px, the pointer less the size
  edge.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    edge.setPointerCapture(event.pointerId);
    from = place(event) - size();
  });
  edge.addEventListener("pointermove", (event) => edge.hasPointerCapture(event.pointerId) && set(place(event) - from));
  edge.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: 1, ArrowRight: -1, ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!steps || (along === "x") !== (event.key === "ArrowLeft" || event.key === "ArrowRight")) return;
    event.preventDefault();
    event.stopPropagation();
    set(size() + steps * STEP_PX);
  });
  return edge;
}

/** @returns {Partial<Kept>} what the browser has kept, if it can be read */
function kept() {
  try {
    const { beside, folded, large, width, heights } = JSON.parse(loadSetting(KEY) ?? "{}");
    const sizes = Object.entries(heights ?? {}).filter(([, size]) => typeof size === "number");
    return {
      ...(typeof beside === "boolean" && { beside }), ...(Array.isArray(folded) && { folded }), ...(Array.isArray(large) && { large }),
      ...(typeof width === "number" && { width }), heights: Object.fromEntries(sizes),
    };
  } catch {
    return {};
  }
}
