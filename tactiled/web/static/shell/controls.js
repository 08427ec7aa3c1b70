/** Buttons, fields and keys. @module */

import * as api from "../wire/api.js";
import { byId, context2d, drawnFiner, setText, themeColors } from "./dom.js";
import { download } from "../export/download.js";
import { csvText } from "../export/export_csv.js";
import { PICTURE_RATIO, picture } from "../export/export_png.js";
import { Film } from "../export/film.js";
import { positionText } from "./format.js";
import { ACROSS } from "../maps/geometry.js";
import { listenForKeys } from "./keyboard.js";
import { notice } from "./notice.js";
import { PlaybackSession } from "../playback/playback_session.js";
import { provenance } from "../export/provenance.js";
import { methodTitle } from "./readings.js";
import { reportHtml } from "../export/report.js";
import { loadSetting, saveSetting } from "./storage.js";
import { tare, undoTare } from "../calibration/tare.js";
import { timeOffset } from "./timeline.js";
import { SHEAR } from "../wire/wire.js";
import { withToken } from "../wire/token_dialog.js";

/** @import { CalibrationPage } from "../calibration/calibration_page.js" */
/** @import { Colormap } from "../maps/colormap.js" */
/** @import { Frame } from "../wire/frame_history.js" */
/** @import { KeyEntry } from "../export/report.js" */
/** @import { PageText } from "./page_text.js" */
/** @import { PlaybackPage } from "../playback/playback_page.js" */
/** @import { Recorder } from "../playback/recorder.js" */
/** @import { Session } from "../wire/session.js" */
/** @import { Viewer } from "./viewer.js" */

/**
 * What the controls act on beside the viewer.
 * @typedef {object} Targets
 * @property {PageText} screen
 * @property {Recorder} recorder
 * @property {CalibrationPage} calibration
 * @property {PlaybackPage} playback
 * @property {() => string[]} sensors names of them
 * @property {(name: string) => void} choose a sensor, or all of them
 * @property {() => void} toggleWall
 * @property {() => void} nextTheme
 */

export const CONTACTS_KEY = "tactiled.contacts"; // whether they are shown
const PATH_KEY = "tactiled.path"; // whether that of the centre of pressure is shown

const CHARTS = ["section", "forces", "plot-chart"]; // of a report

const picker = /** @type {HTMLSelectElement} */ (byId("method"));
const help = /** @type {HTMLDialogElement} */ (byId("help"));

/** Wire everything that can be pressed. @param {Viewer} viewer @param {Targets} targets */
export function controls(viewer, targets) {
  buttons(viewer, targets);
  range(viewer, targets);
  keyboard(viewer, targets);
  filming(viewer, targets);
  picker.addEventListener("change", () => chooseMethod(viewer));
}

/** @param {Viewer} viewer @param {Targets} targets */
function buttons(viewer, targets) {
  const scrub = /** @type {HTMLInputElement} */ (byId("scrub"));
  const contacts = /** @type {HTMLInputElement} */ (byId("contacts-on"));
  const shear = /** @type {HTMLInputElement} */ (byId("shear-on"));
  const press = (/** @type {string} */ id, /** @type {() => void} */ action) => byId(id).addEventListener("click", action);
  press("pause", () => viewer.pause(!viewer.session?.paused));
  press("back", () => viewer.step(-1));
  press("forward", () => viewer.step(1));
  const hold = /** @type {HTMLSelectElement} */ (byId("hold"));
  const path = /** @type {HTMLInputElement} */ (byId("path-on"));
  hold.addEventListener("change", () => viewer.hold(/** @type {import("../maps/held_image.js").Held} */ (hold.value)));
  press("hold-reset", () => viewer.hold("peak"));
  path.checked = viewer.path = loadSetting(PATH_KEY) === "true";
  path.addEventListener("change", () => {
    viewer.path = path.checked;
    saveSetting(PATH_KEY, String(path.checked));
    viewer.refresh();
  });
  press("section-turn", () => turn(viewer));
  press("tare", () => tare(viewer.name));
  press("tare-undo", () => undoTare(viewer.name));
  press("calibrate-open", () => targets.calibration.open());
  press("save-png", () => save("png", viewer, targets));
  press("save-csv", () => save("csv", viewer, targets));
  press("save-report", () => save("html", viewer, targets));
  press("copy-link", () => copyLink(viewer));
  press("help-open", showHelp);
  press("help-close", () => help.close());
  press("banner-action", () => viewer.session?.stream.retry());
  scrub.addEventListener("input", () => viewer.show(Number(scrub.max) - Number(scrub.value)));
  contacts.addEventListener("change", () => {
    saveSetting(CONTACTS_KEY, String(contacts.checked));
    viewer.showContacts(contacts.checked);
  });
  shear.addEventListener("change", () => viewer.showShear(shear.checked));
}

/** Copy the address, which keeps sensor, view, colours, fixed range and place in a recording. @param {Viewer} viewer */
async function copyLink(viewer) {
  const link = viewer.view.link;
  try {
    await navigator.clipboard.writeText(link); // which a page from another machine without TLS may not
    notice("Link copied.");
  } catch {
    notice(`The browser does not let this page copy; the link is ${link}`, true);
  }
}

/** Open the help at its beginning: the button that takes the focus stands at its end. */
function showHelp() {
  help.showModal();
  help.scrollTop = 0;
}

/** @param {Viewer} viewer @param {Targets} targets */
function range(viewer, targets) {
  const auto = /** @type {HTMLInputElement} */ (byId("range-auto"));
  const low = /** @type {HTMLInputElement} */ (byId("range-low"));
  const high = /** @type {HTMLInputElement} */ (byId("range-high"));
  byId("range").addEventListener("submit", (event) => event.preventDefault());
  auto.addEventListener("change", () => setAuto(auto.checked, viewer, targets));
  low.addEventListener("change", () => fix(low.valueAsNumber, viewer.range.high, viewer, targets));
  high.addEventListener("change", () => fix(viewer.range.low, high.valueAsNumber, viewer, targets));
}

/**
 * Fix the range, or say why the range is refused.
 * @param {number} low NaN where no number stands there
 * @param {number} high
 * @param {Viewer} viewer
 * @param {Targets} targets
 */
function fix(low, high, viewer, targets) {
  const why = viewer.range.fix(low, high);
  if (why) notice(`${why}; range unchanged.`, true);
  targets.screen.range(viewer.range, true);
  viewer.refresh();
}

/** @param {boolean} auto @param {Viewer} viewer @param {Targets} targets */
function setAuto(auto, viewer, targets) {
  const { range } = viewer;
  if (auto) range.release();
  else range.fix(range.low, range.high);
  targets.screen.range(range);
  viewer.refresh();
}

/** @param {Viewer} viewer */
async function chooseMethod(viewer) {
  const { value } = picker;
  picker.blur();
  if (viewer.session instanceof PlaybackSession) {
    viewer.session.restoreBy(value);
    notice(`Method of this playback: ${methodTitle(value)}`);
    return;
  }
  if (await withToken(() => api.setMethod(viewer.name, value), "Method not changed")) notice(`Method: ${methodTitle(value)}`);
  else picker.value = viewer.session?.status?.method ?? picker.value;
}

/**
 * What can be saved of what is seen.
 * @typedef {object} Seen
 * @property {Session|PlaybackSession} session
 * @property {Frame} frame
 * @property {Colormap} colormap
 * @property {string} state
 */

/** @param {Viewer} viewer @param {Targets} targets @returns {Seen|null} null, and a notice, where nothing is seen */
function seen(viewer, targets) {
  const { session, frame, view: { colormap } } = viewer;
  if (!session || !frame || !colormap) {
    notice(viewer.name ? "There is no frame to save yet." : "To save a frame, choose one sensor.", true);
    return null;
  }
  const { level } = targets.screen;
  const recorded = session instanceof PlaybackSession ? `${session.recorded.name} at ${positionText(session.position)}` : "";
  const still = level === "live" ? "paused" : `paused, ${level}`;
  const moment = recorded || (session.paused ? still : level);
  return { session, frame, colormap, state: viewer.held.text ? `${moment}, ${viewer.held.text}` : moment };
}

/** @param {Seen} of @param {Viewer} viewer @returns {[string, string][]} what is said of the picture */
function originOf({ session, frame, state }, { contactsOfFrame }) {
  const offset = contactsOfFrame?.contacts.length ? timeOffset(contactsOfFrame, frame) : "";
  return provenance(session.name, frame, session.statusOfFrame, state + (offset && `, contacts from ${offset}`));
}

/** @param {Seen} of @param {Viewer} viewer @returns {HTMLCanvasElement} at twice the size */
function finePicture(of, viewer) {
  const { session, frame, colormap } = of;
  /** @type {HTMLCanvasElement|null} */
  let drawn = null;
  drawnFiner(PICTURE_RATIO, () => {
    viewer.paintMaps(frame, colormap);
    drawn = picture(session, frame, viewer, colormap, originOf(of, viewer));
  });
  viewer.paintMaps(frame, colormap);
  return /** @type {any} */ (drawn);
}

/** @param {"png"|"csv"|"html"} kind @param {Viewer} viewer @param {Targets} targets */
function save(kind, viewer, targets) {
  viewer.paintNow();
  const of = seen(viewer, targets);
  if (!of) return;
  const { session: { name, plane, statusOfFrame }, frame, state } = of;
  if (kind === "csv") {
    const text = csvText(plane, frame, provenance(name, frame, statusOfFrame, state));
    download(name, frame, "csv", new Blob([text], { type: "text/csv" }));
  } else if (kind === "png") finePicture(of, viewer).toBlob((blob) => blob && download(name, frame, "png", blob), "image/png");
  else download(name, frame, "html", new Blob([report(of, viewer)], { type: "text/html" }));
}

/** @param {Seen} of @param {Viewer} viewer @returns {string} a page of HTML */
function report(of, viewer) {
  const { session, frame } = of;
  const charts = CHARTS.map((id) => /** @type {HTMLCanvasElement} */ (byId(id))).filter((each) => each.offsetParent && !viewer.held.text);
  return reportHtml({
    title: `${session.name}, frame ${frame.sequence}`,
    frame,
    plane: session.plane,
    origin: originOf(of, viewer),
    pictures: [
      { title: "Maps", address: finePicture(of, viewer).toDataURL(), key: null },
      ...charts.map((each) => ({ title: each.ariaLabel ?? "", address: onPanel(each), key: keyOf(each) })),
    ],
    contacts: viewer.contacts ? viewer.contactsOfFrame?.contacts ?? null : [],
    regions: viewer.regions?.measured() ?? [],
    trace: session instanceof PlaybackSession ? null : session.history.trace,
    colors: themeColors(),
  });
}

/** @param {HTMLCanvasElement} chart @returns {KeyEntry[]} what its lines are, as on the page */
function keyOf(chart) {
  const entries = /** @type {HTMLElement[]} */ ([...(chart.parentElement?.querySelector(".key, #plot-key")?.children ?? [])]);
  return entries.filter((each) => each.offsetWidth).map((each) => {
    const sample = each.querySelector("path");
    const { color, stroke } = getComputedStyle(sample ?? each);
    const name = `${each.textContent?.replace(" ✕", "")}, ${chart.dataset.unit}`;
    return { name, color: sample ? stroke : color, dash: sample?.getAttribute("stroke-dasharray") ?? "", isBand: each.classList.contains("band") };
  });
}

/** @param {HTMLCanvasElement} chart @returns {string} the address of its picture on the ground that it has on the page */
function onPanel(chart) {
  const copy = document.createElement("canvas");
  const margin = 10 * (window.devicePixelRatio || 1);
  copy.width = chart.width + 2 * margin;
  copy.height = chart.height + 2 * margin;
  const pen = context2d(copy);
  pen.fillStyle = themeColors().panel;
  pen.fillRect(0, 0, copy.width, copy.height);
  pen.drawImage(chart, margin, margin);
  return copy.toDataURL();
}

/** Run the button for films. @param {Viewer} viewer @param {Targets} targets */
function filming(viewer, targets) {
  let last = 0; // number of the frame of the recording that was taken last
  const film = new Film(() => {
    const of = seen(viewer, targets);
    return of && { sensor: of.session.name, frame: of.frame, picture: picture(of.session, of.frame, viewer, of.colormap, originOf(of, viewer), 1) };
  });
  byId("film").addEventListener("click", () => {
    if (film.runs) film.end();
    else if (film.begin() && viewer.session instanceof PlaybackSession && viewer.session.paused) viewer.pause(false);
    last = -1;
  });
  viewer.onPainted = (now) => {
    film.painted(now);
    const { session } = viewer;
    if (!film.runs || !(session instanceof PlaybackSession)) return;
    if (session.number < last || (session.paused && session.back === 0)) film.end();
    last = session.number;
  };
}

/** Move the pinned probe by cells. @param {Viewer} viewer @param {number} dx @param {number} dy @returns {boolean} one is pinned */
function nudge({ probe, session }, dx, dy) {
  const plane = session?.plane;
  if (plane) probe.nudge(dx * plane.restored.side, dy * plane.restored.side, plane);
  return probe.pinned;
}

/** @param {Viewer} viewer */
function turn(viewer) {
  if (!viewer.session) return;
  viewer.setSectionAxis(ACROSS[viewer.marks.along]);
  setText(byId("announce-politely"), `Cross-section along ${viewer.marks.along}.`);
}

/** @param {Viewer} viewer */
function pin(viewer) {
  const { session } = viewer;
  const of = session?.frame?.ofRestored;
  if (!session || !of) return;
  const { plane } = session;
  viewer.probe.pin(of.contact ? of.x : plane.left + plane.width / 2, of.contact ? of.y : plane.top + plane.height / 2);
}

/** @param {Viewer} viewer @param {Targets} targets */
function keyboard(viewer, targets) {
  const contacts = byId("contacts-on");
  const shear = byId("shear-on");
  listenForKeys({
    " ": () => viewer.pause(!viewer.session?.paused),
    ArrowLeft: ({ shiftKey }) => viewer.step(shiftKey ? -10 : -1),
    ArrowRight: ({ shiftKey }) => viewer.step(shiftKey ? 10 : 1),
    "Alt+ArrowLeft": () => nudge(viewer, -1, 0),
    "Alt+ArrowRight": () => nudge(viewer, 1, 0),
    "Alt+ArrowUp": () => nudge(viewer, 0, -1),
    "Alt+ArrowDown": () => nudge(viewer, 0, 1),
    l: () => (targets.playback.recording ? targets.playback.close() : viewer.pause(false)),
    "<": () => targets.playback.changeSpeed(-1),
    ">": () => targets.playback.changeSpeed(1),
    a: () => setAuto(!viewer.range.auto, viewer, targets),
    o: () => contacts.click(),
    v: () => viewer.session?.kinds.includes(SHEAR) && shear.click(),
    t: () => targets.playback.refuses("tare") || tare(viewer.name),
    k: () => targets.playback.refuses("calibrate") || targets.calibration.open(),
    r: () => targets.playback.refuses("record") || targets.recorder.toggle(),
    s: () => save("png", viewer, targets),
    c: () => save("csv", viewer, targets),
    w: targets.toggleWall,
    d: targets.nextTheme,
    m: () => picker.focus(),
    x: () => turn(viewer),
    p: () => pin(viewer),
    "?": showHelp,
    Escape: () => viewer.probe.clear(),
    ...Object.fromEntries(Array.from({ length: 9 }, (_, i) => [String(i + 1), () => {
      const name = targets.sensors()[i];
      if (name) targets.choose(name);
    }])),
  }, /** @type {HTMLInputElement} */ (byId("keys-on")));
}
