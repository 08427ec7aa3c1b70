/** Small helpers for canvases and text, shared by everything that draws. @module */

const CONFIRM_MS = 4000; // that a button to delete something waits for its second press

/**
 * @template {HTMLElement} T
 * @param {string} id
 * @returns {T} the element, which the page must have
 */
export function byId(id) {
  const colors = document.getElementById(id);
  if (!colors) throw new Error(`the page has no element "${id}"`);
  return /** @type {T} */ (colors);
}

/**
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {string} className
 * @param {...(Node|string)} children
 * @returns {HTMLElementTagNameMap[T]} a new element
 */
export function element(tag, className, ...children) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.append(...children);
  return made;
}

/**
 * Set an element's text where it differs, so that an unchanged reading costs nothing.
 * @param {Element} element
 * @param {string} text
 */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** @param {HTMLCanvasElement} canvas @returns {CanvasRenderingContext2D} */
export function context2d(canvas) {
  const context = canvas.getContext("2d");
  if (!context) throw new Error("this browser gives no 2D canvas");
  return context;
}

let pictureRatio = 0; // pixels per CSS px while a picture is made

/** Draw finer meanwhile, for a picture. @param {number} ratio pixels per CSS px @param {() => void} action */
export function drawnFiner(ratio, action) {
  pictureRatio = ratio;
  try {
    action();
  } finally {
    pictureRatio = 0;
  }
}

/**
 * Fit a canvas's pixels to the size it is shown at.
 * @param {HTMLCanvasElement} canvas
 * @param {number} width CSS px
 * @param {number} height CSS px
 * @param {number} [ratio] pixels per CSS px, else those of the picture or the screen
 * @returns {number} pixels per CSS px
 */
export function fitCanvas(canvas, width, height, ratio = pictureRatio || window.devicePixelRatio || 1) {
  const w = Math.max(1, Math.round(width * ratio));
  const h = Math.max(1, Math.round(height * ratio));
  if (canvas.width !== w) canvas.width = w;
  if (canvas.height !== h) canvas.height = h;
  return ratio;
}

/** @typedef {"raw"|"restored"|"accent"|"series1"|"series2"|"series3"|"series4"|"series5"|"series6"} Ink colour of a line */

/**
 * The page's colours as the theme has them now.
 * @typedef {Record<Ink|"text"|"muted"|"line"|"panel"|"font", string> & {forced: boolean}} ThemeColors where `forced`, the
 *   system allows few colours: they alone tell nothing apart
 */

/** @returns {ThemeColors} */
export function themeColors() {
  const swatch = document.createElement("i");
  swatch.hidden = true;
  document.body.append(swatch);
  const style = getComputedStyle(swatch);
  const of = (/** @type {string} */ name) => {
    swatch.style.color = `var(--${name})`;
    return style.color;
  };
  const colors = {
    text: of("text"), muted: of("muted"), line: of("line"), panel: of("panel"), raw: of("raw"),
    restored: of("restored"), accent: of("accent"), series1: of("series1"), series2: of("series2"), series3: of("series3"),
    series4: of("series4"), series5: of("series5"), series6: of("series6"), font: getComputedStyle(document.body).fontFamily,
    forced: matchMedia("(forced-colors: active)").matches,
  };
  swatch.remove();
  return colors;
}

/** @param {HTMLButtonElement} button to delete something @returns {boolean} it was pressed twice */
export function confirmed(button) {
  const sure = button.dataset.sure !== undefined;
  const reset = () => {
    delete button.dataset.sure;
    button.textContent = "Delete";
  };
  if (sure) reset();
  else {
    button.dataset.sure = "";
    button.textContent = "Really delete";
    setTimeout(reset, CONFIRM_MS);
  }
  return sure;
}
