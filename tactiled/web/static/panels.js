/** Where the panels stand, and which are folded or large; the browser keeps it. @module */

import { byId, element } from "./dom.js";
import { loadSetting, saveSetting } from "./storage.js";

const KEY = "tactiled.panels";
const BESIDE_FROM_PX = 1700; // CSS px, of a window in which maps lose nothing to panels beside them

export class Panels {
  /** @param {() => void} onChange */
  constructor(onChange) {
    this._onChange = onChange;
    /** Of panels. @type {{beside: boolean, folded: string[], large: string[]}} */
    this._kept = { beside: window.innerWidth >= BESIDE_FROM_PX, folded: [], large: [], ...kept() };
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
    }
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
    button.setAttribute("aria-label", `${verb} ${title.firstChild?.textContent?.trim() || title.textContent}`);
    button.addEventListener("click", () => {
      const others = this._kept[kind].filter((each) => each !== title.id);
      this._kept[kind] = others.length < this._kept[kind].length ? others : [...others, title.id];
      show();
      this._show();
    });
    show();
    return button;
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

/** @returns {object} what the browser has kept, if it can be read */
function kept() {
  try {
    const { beside, folded, large } = JSON.parse(loadSetting(KEY) ?? "{}");
    return { ...(typeof beside === "boolean" && { beside }), ...(Array.isArray(folded) && { folded }), ...(Array.isArray(large) && { large }) };
  } catch {
    return {};
  }
}
