/**
 * The viewer: wires the stream to the maps, the charts and the readings.
 * @module
 */

import * as api from "./api.js";
import { Colorbar } from "./colorbar.js";
import { Forces } from "./forces.js";
import { judge } from "./health.js";
import { Heatmap, Palette } from "./heatmap.js";
import { History } from "./history.js";
import { KernelPanel } from "./kernel.js";
import { keys } from "./keys.js";
import { byId, fixed, say } from "./paint.js";
import { Plane } from "./plane.js";
import { Probe } from "./probe.js";
import { Readings, methodTitle } from "./readings.js";
import { savePng, saveCsv } from "./save.js";
import { Scale } from "./scale.js";
import { Section, highest } from "./section.js";
import { Stream } from "./stream.js";
import { Tabs } from "./tabs.js";
import { theme } from "./theme.js";
import { DEAD, MISSING, BAD, SATURATED } from "./wire.js";

/** @typedef {import("./history.js").Frame} Frame */
/** @typedef {import("./stream.js").Status} Status */

const READ_MS = 125; // between two updates of the numbers
const POLL_MS = 2000; // between two looks at the list of sensors
const STAYS = 0.85; // of the peak that the cross-section must still reach where it is
const FLAGS = /** @type {const} */ ([[DEAD, "dead"], [BAD, "bad"], [MISSING, "missing"], [SATURATED, "saturated"]]);

const DESK = matchMedia("(min-width: 900px)"); // where the maps share the window's height
const root = document.documentElement;
const boxes = byId("boxes");
const banner = byId("banner");
const pause = /** @type {HTMLButtonElement} */ (byId("pause"));
const scrub = /** @type {HTMLInputElement} */ (byId("scrub"));
const picker = /** @type {HTMLSelectElement} */ (byId("method"));
const autoRange = /** @type {HTMLInputElement} */ (byId("range-auto"));
const lowInput = /** @type {HTMLInputElement} */ (byId("range-low"));
const highInput = /** @type {HTMLInputElement} */ (byId("range-high"));
const help = /** @type {HTMLDialogElement} */ (byId("help"));

const scale = new Scale();
const rawMap = new Heatmap(byId("raw"), byId("raw-marks"), byId("raw-frame"));
const restoredMap = new Heatmap(byId("restored"), byId("restored-marks"), byId("restored-frame"));
const colorbar = new Colorbar(byId("colorbar"));
const section = new Section(byId("section"));
const forces = new Forces(byId("forces"));
const kernelPanel = new KernelPanel(byId("kernel"));
const readings = new Readings();
const tabs = new Tabs((name) => select(name));
const probe = new Probe([rawMap, restoredMap], () => refresh());

/** @type {Palette|null} */
let palette = null;
/** @type {Stream|null} */
let stream = null;
/** @type {Plane|null} */
let plane = null;
/** @type {History|null} */
let history = null;
/** @type {Status|null} */
let status = null;
let toldAt = 0;
let pairAt = 0;
/** @type {import("./api.js").Sensor[]} */
let sensors = [];
let chosen = "";
let selection = 0; // counts up, so that an answer for a sensor left meanwhile is dropped
let paused = false;
let back = 0; // which kept frame is shown, 0 the newest
let fresh = false; // a pair came that is not painted yet
let dirty = false;
let painted = 0;
let level = "";
let reachable = true;
let sectionY = NaN;
let skew = Infinity; // least of (arrival - sent), s
let latency = NaN;
const paintTimes = new Float64Array(128);
const marks = { lineY: NaN, probeX: NaN, probeY: NaN, pinned: false };
root.dataset.painted = "0";

// Painting

/** Paint at the screen's next turn. */
function refresh() {
  if (dirty) return;
  dirty = true;
  requestAnimationFrame(paint);
}

/** @param {number} now ms */
function paint(now) {
  dirty = false;
  if (!plane || !history || !palette) return;
  const frame = history.at(back);
  colorbar.draw(scale, palette);
  if (!frame) {
    section.draw(null, plane.top, NaN, scale);
    forces.draw(history, 0);
    return;
  }
  rawMap.paint(frame.raw, scale, palette);
  restoredMap.paint(frame.restored, scale, palette);
  placeMarks(frame, plane);
  const flags = frame.saturated ? frame.flags : null;
  rawMap.mark(marks, frame.ofRaw, flags, plane.raw);
  restoredMap.mark(marks, frame.ofRestored, flags, plane.raw);
  section.draw(frame, sectionY, probe.x, scale);
  forces.draw(history, back);
  if (!fresh) return;
  fresh = false;
  paintTimes[painted % paintTimes.length] = now;
  painted += 1;
  root.dataset.painted = String(painted);
  measureLatency(frame);
  if (!paused) stream?.next();
}

/**
 * @param {Frame} frame
 * @param {Plane} on
 */
function placeMarks(frame, on) {
  const { ofRestored } = frame;
  if (Number.isFinite(probe.y)) sectionY = probe.y;
  else if (ofRestored.contact) {
    // The line stays until the peak has clearly moved: noise alone must not make it jump between equal rows.
    const stays = highest(on, sectionY, frame.restored) >= STAYS * ofRestored.peak;
    if (!stays) sectionY = on.restored.y[ofRestored.peakIndex];
  } else if (!Number.isFinite(sectionY)) sectionY = on.top + on.height / 2;
  marks.lineY = sectionY;
  marks.probeX = probe.x;
  marks.probeY = probe.y;
  marks.pinned = probe.pinned;
}

/** @param {Frame} frame */
function measureLatency(frame) {
  const now = Date.now() / 1000;
  skew = Math.min(skew, now - frame.sent);
  const away = clocksDiffer() ? frame.sent + skew : frame.sent;
  latency = (now - away + (frame.sent - frame.timestamp)) * 1000;
}

/** @returns {boolean} the browser's clock and the service's are too far apart to compare */
function clocksDiffer() {
  return Number.isFinite(skew) && Math.abs(skew) > 0.25;
}

/** Make both maps as large as their boxes allow, true to scale; the cells of a grid on whole pixels where cheap. */
function layout() {
  if (!plane) return;
  const box = /** @type {HTMLElement} */ (rawMap.frame.parentElement);
  const stacked = plane.width > 1.5 * plane.height;
  boxes.classList.toggle("stacked", stacked);
  const height = DESK.matches ? box.clientHeight : 0.7 * window.innerHeight;
  let zoom = Math.min(box.clientWidth / plane.width, height / plane.height);
  if (plane.isGrid) {
    const cell = Math.min(plane.raw.side, plane.restored.side);
    const ratio = window.devicePixelRatio || 1;
    const whole = Math.floor(zoom * cell * ratio) / ratio / cell;
    if (whole > 0.94 * zoom) zoom = whole;
  }
  rawMap.resize(zoom);
  restoredMap.resize(zoom);
  const length = roundDown((0.3 * box.clientWidth) / zoom);
  byId("ruler-bar").style.width = `${length * zoom}px`;
  say(byId("ruler-text"), `${length} mm`);
  const apart = restoredMap.frame.getBoundingClientRect().top - rawMap.frame.getBoundingClientRect().top;
  byId("legend").style.setProperty("--map-height", `${apart + plane.height * zoom}px`);
  colorbar.forget();
  kernelPanel.draw();
  refresh();
}

/**
 * @param {number} length
 * @returns {number} a round number not above it
 */
function roundDown(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return ([5, 2, 1].find((step) => step * power <= length) ?? 1) * power;
}

// Reading

/** Update everything that is text. */
function read() {
  const health = judge(stream, status, toldAt, pairAt);
  showHealth(reachable || chosen ? health : unreachable());
  const frame = history?.at(back) ?? null;
  readings.frame(frame);
  const live = health.level === "live";
  readings.status(status, live);
  readings.pace(fps(), live && !paused && painted ? latency : NaN, clocksDiffer() ? skew : 0);
  showProbe(frame);
  showRange();
  showPlayback(frame, live);
  say(byId("section-where"), Number.isFinite(sectionY) && frame ? `y ${fixed(sectionY, 1)} mm${probe.pinned ? ", pinned" : ""}` : "");
}

/** @returns {import("./health.js").Health} */
function unreachable() {
  return { level: "disconnected", title: "DISCONNECTED", text: "The service does not answer. Retrying." };
}

/** @param {import("./health.js").Health} health */
function showHealth(health) {
  if (health.level !== level) {
    level = health.level;
    const name = chosen || "service";
    say(byId("announce"), level === "live" ? `${name} is live` : level === "connecting" ? "" : `${name}: ${health.title.toLowerCase()}. ${health.text}`);
  }
  document.body.dataset.level = health.level;
  document.body.classList.toggle("paused", paused);
  const bad = health.title !== "" && health.level !== "connecting";
  banner.hidden = !bad;
  say(byId("banner-title"), health.title);
  say(byId("banner-text"), health.text);
  const action = byId("banner-action");
  action.hidden = health.level !== "disconnected" || stream?.link !== "closed";
  say(action, "Retry now");
  const pill = { live: paused ? "paused" : "live", down: "bus down" };
  say(byId("pill-text"), pill[/** @type {keyof pill} */ (health.level)] ?? health.level);
  const title = chosen ? `${chosen}${health.level === "live" ? "" : ` (${health.level})`}, tactiled` : "tactiled";
  if (document.title !== title) document.title = title;
}

/** @returns {number} pairs painted in the last second */
function fps() {
  const since = performance.now() - 1000;
  const known = Math.min(painted, paintTimes.length);
  let count = 0;
  for (let i = 0; i < known; i += 1) if (paintTimes[i] > since) count += 1;
  return count;
}

/** @param {Frame|null} frame */
function showProbe(frame) {
  const line = byId("probe");
  if (!frame || !plane || !Number.isFinite(probe.x)) {
    say(line, "Point at a map to read it; click to pin.");
    return;
  }
  const r = plane.find(plane.raw, probe.x, probe.y);
  const s = plane.find(plane.restored, probe.x, probe.y);
  const place = `x ${fixed(probe.x, 1)}  y ${fixed(probe.y, 1)} mm`;
  if (r < 0 || s < 0) {
    say(line, `${place}: no taxel here`);
    return;
  }
  const raw = Number.isNaN(frame.raw[r]) ? "unknown" : `${fixed(frame.raw[r], 1)} kPa`;
  const flags = FLAGS.filter(([bit]) => frame.flags[r] & bit).map(([, name]) => name);
  const taxel = plane.isGrid ? `taxel ${Math.floor(r / plane.raw.columns)}, ${r % plane.raw.columns}` : `taxel ${r}`;
  say(line, `${place}  raw ${raw}  restored ${fixed(frame.restored[s], 1)} kPa  ${taxel}${flags.length ? `, ${flags.join(", ")}` : ""}`);
}

function showRange() {
  autoRange.checked = scale.auto;
  for (const [input, value] of /** @type {[HTMLInputElement, number][]} */ ([[lowInput, scale.low], [highInput, scale.high]])) {
    if (document.activeElement !== input) {
      const text = String(+value.toPrecision(4));
      if (input.value !== text) input.value = text;
      input.setAttribute("aria-invalid", "false");
    }
  }
}

/**
 * @param {Frame|null} frame
 * @param {boolean} live
 */
function showPlayback(frame, live) {
  const kept = history?.length ?? 0;
  pause.setAttribute("aria-pressed", String(paused));
  say(pause, paused ? "Go live" : "Pause");
  scrub.max = String(Math.max(0, kept - 1));
  scrub.value = String(kept - 1 - back);
  scrub.disabled = kept < 2;
  const newest = history?.at(0);
  const when = frame && newest && back ? `${fixed(frame.timestamp - newest.timestamp, 2)} s` : "newest";
  const text = paused ? when : live ? "live" : "last";
  say(byId("when"), text);
  scrub.setAttribute("aria-valuetext", text);
}

// Playback and range

/** @param {boolean} to */
function setPaused(to) {
  paused = to;
  if (!to) {
    back = 0;
    stream?.next();
  }
  refresh();
  read();
}

/**
 * Show another kept frame.
 * @param {number} to how far back
 */
function show(to) {
  if (!history || !history.length) return;
  if (!paused) setPaused(true);
  back = Math.max(0, Math.min(history.length - 1, to));
  refresh();
  read();
}

function typedRange() {
  const fine = scale.fix(lowInput.valueAsNumber, highInput.valueAsNumber);
  for (const input of [lowInput, highInput]) input.setAttribute("aria-invalid", String(!fine));
  if (fine) autoRange.checked = false;
  refresh();
}

/** @param {boolean} auto */
function setAuto(auto) {
  if (auto) scale.release();
  else scale.fix(scale.low, scale.high);
  showRange();
  refresh();
}

// The service

let noticeTimer = 0;

/**
 * Say something in passing.
 * @param {string} text
 * @param {boolean} [bad]
 */
function notice(text, bad = false) {
  const element = byId("notice");
  say(element, text);
  element.hidden = false;
  element.classList.toggle("bad", bad);
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => { element.hidden = true; }, bad ? 8000 : 3000);
}

/** @param {unknown} error */
const words = (error) => (error instanceof Error ? error.message : String(error));

/**
 * Show another sensor.
 * @param {string} name
 */
async function select(name) {
  if (name === chosen) return;
  const mine = ++selection;
  stream?.stop();
  stream = null;
  chosen = name;
  status = null;
  plane = null;
  history = null;
  back = 0;
  paused = fresh = false;
  latency = NaN;
  skew = Infinity;
  sectionY = NaN;
  pairAt = 0;
  probe.clear();
  scale.reset();
  rawMap.clear();
  restoredMap.clear();
  kernelPanel.use(null);
  tabs.choose(name);
  showSensor(sensors.find((each) => each.name === name));
  try {
    window.history.replaceState(null, "", `#${encodeURIComponent(name)}`);
  } catch {
    // The address is a convenience only.
  }
  read();
  await open(name, mine);
}

/**
 * @param {string} name
 * @param {number} mine
 */
async function open(name, mine) {
  let found;
  try {
    found = new Plane(await api.geometry(name));
  } catch (error) {
    if (mine !== selection) return;
    notice(`${name}: ${words(error)}`, true);
    chosen = "";
    return;
  }
  if (mine !== selection) return;
  plane = found;
  history = new History(plane);
  rawMap.use(plane, plane.raw);
  restoredMap.use(plane, plane.restored);
  section.use(plane);
  forces.use(history);
  layout();
  stream = new Stream(api.streamUrl(name), { onPair, onStatus, onLink });
  read();
  try {
    const kernel = await api.kernel(name);
    if (mine === selection) kernelPanel.use(kernel);
  } catch (error) {
    if (mine === selection) notice(`Cover of ${name}: ${words(error)}`, true);
  }
}

/**
 * @param {import("./wire.js").Packet} raw
 * @param {import("./wire.js").Packet} restored
 */
function onPair(raw, restored) {
  if (!history || paused) return;
  if (!history.fits(raw, restored)) {
    reopen();
    return;
  }
  const newest = history.at(0);
  if (newest && (restored.timestamp < newest.timestamp || restored.timestamp > newest.timestamp + 60)) {
    history.clear();
  }
  const frame = history.push(raw, restored);
  pairAt = performance.now();
  const noise = Number.isFinite(frame.noiseKpa) ? frame.noiseKpa : 0;
  const gain = Number.isFinite(frame.noiseGain) ? frame.noiseGain : 1;
  const peak = Math.max(frame.ofRaw.peak || 0, frame.ofRestored.peak || 0);
  scale.follow(peak, noise * Math.max(1, gain), frame.timestamp);
  fresh = true;
  refresh();
}

/** The sensor has another shape than this page believes: take it up anew. */
function reopen() {
  const name = chosen;
  chosen = "";
  select(name);
}

/** @param {Status} told */
function onStatus(told) {
  const changed = status?.state !== told.state || status?.method !== told.method;
  status = told;
  toldAt = performance.now();
  tabs.mark(told.sensor, told.state);
  if (document.activeElement !== picker && picker.value !== told.method) picker.value = told.method;
  if (changed) read();
}

function onLink() {
  if (stream?.link === "open" && !paused) stream.next();
  read();
}

/** @param {import("./api.js").Sensor|undefined} sensor */
function showSensor(sensor) {
  if (!sensor) return;
  readings.about(sensor);
  const names = sensor.methods.includes(sensor.method) ? sensor.methods : [sensor.method, ...sensor.methods];
  if (names.join() === [...picker.options].map((each) => each.value).join()) return;
  picker.replaceChildren(...names.map((each) => new Option(methodTitle(each), each)));
  picker.value = sensor.method;
}

/** Look at the list of sensors, now and for ever. */
async function poll() {
  try {
    const listed = await api.sensors();
    reachable = true;
    sensors = listed;
    tabs.update(listed);
    if (!palette) palette = new Palette((await api.colormap()).colors);
    const asked = decodeURIComponent(location.hash.slice(1));
    const known = listed.find((each) => each.name === (chosen || asked)) ?? listed[0];
    if (known && known.name !== chosen) select(known.name);
    tabs.choose(chosen);
    showSensor(listed.find((each) => each.name === chosen));
    if (stream?.link === "closed") stream.retry();
    if (!listed.length) notice("No sensor is configured.", true);
  } catch (error) {
    reachable = !(error instanceof api.ApiError) || error.status !== 0;
    if (reachable) notice(words(error), true);
    for (const name of tabs.names) tabs.mark(name, "unknown");
  }
  setTimeout(poll, POLL_MS);
}

async function chooseMethod() {
  const { value } = picker;
  picker.blur();
  try {
    await api.setMethod(chosen, value);
    notice(`Method: ${methodTitle(value)}`);
  } catch (error) {
    picker.value = status?.method ?? picker.value;
    notice(`Method not changed: ${words(error)}`, true);
  }
}

async function tare() {
  if (!chosen) return;
  try {
    await api.tare(chosen);
    notice("Tare: the next frames are taken as the unloaded array.");
  } catch (error) {
    notice(`Tare failed: ${words(error)}`, true);
  }
}

/** @param {"png"|"csv"} kind */
function save(kind) {
  const frame = history?.at(back);
  if (!frame || !plane || !palette) {
    notice("There is no frame to save yet.", true);
    return;
  }
  if (kind === "csv") saveCsv(chosen, plane, frame, status?.ran ?? "");
  else savePng(chosen, plane, frame, rawMap, restoredMap, scale, palette, paused ? "paused" : level);
}

// Wiring

pause.addEventListener("click", () => setPaused(!paused));
byId("back").addEventListener("click", () => show(back + 1));
byId("forward").addEventListener("click", () => show(back - 1));
scrub.addEventListener("input", () => show(Number(scrub.max) - Number(scrub.value)));
byId("tare").addEventListener("click", tare);
byId("save-png").addEventListener("click", () => save("png"));
byId("save-csv").addEventListener("click", () => save("csv"));
byId("help-open").addEventListener("click", () => help.showModal());
byId("banner-action").addEventListener("click", () => stream?.retry());
byId("range").addEventListener("submit", (event) => event.preventDefault());
picker.addEventListener("change", chooseMethod);
autoRange.addEventListener("change", () => setAuto(autoRange.checked));
for (const input of [lowInput, highInput]) input.addEventListener("input", typedRange);

const nextTheme = theme(byId("theme"), () => {
  for (const each of [section, forces, kernelPanel]) each.chart.restyle();
  colorbar.forget();
  kernelPanel.draw();
  refresh();
});

/**
 * @param {number} dx
 * @param {number} dy
 * @param {KeyboardEvent} event
 */
function arrow(dx, dy, event) {
  if (event.altKey && plane) probe.nudge(dx * plane.restored.side, dy * plane.restored.side, plane);
  else if (dx) show(back - dx * (event.shiftKey ? 10 : 1));
}

keys({
  " ": () => setPaused(!paused),
  ArrowLeft: (event) => arrow(-1, 0, event),
  ArrowRight: (event) => arrow(1, 0, event),
  l: () => setPaused(false),
  a: () => setAuto(!scale.auto),
  t: tare,
  s: () => save("png"),
  c: () => save("csv"),
  d: nextTheme,
  m: () => picker.focus(),
  p: () => {
    const of = history?.at(back)?.ofRestored;
    if (plane && of) probe.pin(of.contact ? of.x : plane.left + plane.width / 2, of.contact ? of.y : plane.top + plane.height / 2);
  },
  "?": () => help.showModal(),
  Escape: () => probe.clear(),
  ...Object.fromEntries(Array.from({ length: 9 }, (_, i) => [String(i + 1), () => {
    const name = tabs.names[i];
    if (name) select(name);
  }])),
});
document.addEventListener("keydown", (event) => {
  if (event.altKey && probe.pinned && (event.key === "ArrowUp" || event.key === "ArrowDown")) {
    event.preventDefault();
    arrow(0, event.key === "ArrowUp" ? -1 : 1, event);
  }
});

new ResizeObserver(layout).observe(boxes);
for (const id of ["section", "forces", "kernel", "colorbar"]) {
  new ResizeObserver(() => {
    kernelPanel.draw();
    refresh();
  }).observe(byId(id));
}
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) refresh();
});
setInterval(read, READ_MS);
poll();
