/** The page: which sensors there are, which is shown, and what the service offers beside them. @module */

import * as api from "./wire/api.js";
import { CalibrationPage } from "./calibration/calibration_page.js";
import { CONTACTS_KEY, controls } from "./shell/controls.js";
import { byId } from "./shell/dom.js";
import { EventLog } from "./shell/event_log.js";
import { notice, messageOf } from "./shell/notice.js";
import { PageText } from "./shell/page_text.js";
import { Panels } from "./shell/panels.js";
import { PlaybackPage } from "./playback/playback_page.js";
import { PlaybackSession } from "./playback/playback_session.js";
import { methodTitle } from "./shell/readings.js";
import { Recorder } from "./playback/recorder.js";
import { Regions } from "./maps/regions.js";
import { SeriesPanel } from "./charts/series_panel.js";
import { loadSetting, saveSetting } from "./shell/storage.js";
import { ALL, Tabs } from "./shell/tabs.js";
import { canUndo } from "./calibration/tare.js";
import { theme } from "./shell/theme.js";
import { Viewer } from "./shell/viewer.js";
import { Wall } from "./shell/wall.js";
import { kindsOf } from "./wire/wire.js";

/** @import { Sensor } from "./wire/api.js" */
/** @import { Status } from "./wire/sensor_stream.js" */

const READ_MS = 200; // between two updates of the numbers
const POLL_MS = 2000; // between two looks at the list of sensors
const WALL = "#/wall"; // the address of all sensors; a sensor's own has no bare slash
const DEMO_KEY = "tactiled.demo"; // that its hint was closed
const REPLAYED = "recording"; // the clock of a sensor whose bus is not open

const savers = ["save-png", "save-csv", "save-report", "film"].map((id) => /** @type {HTMLButtonElement} */ (byId(id)));
const picker = /** @type {HTMLSelectElement} */ (byId("method"));
const screen = new PageText();
const tabs = new Tabs((name) => choose(name));
const log = new EventLog();
const viewer = new Viewer({
  onChange: () => read(), onStatus: onStatus, onProbe: () => screen.announceProbe(viewer),
  onPlayback: (session) => {
    playback.begin(session);
    showMethod();
  },
});
viewer.regions = new Regions(viewer);
const series = new SeriesPanel(viewer);
const wall = new Wall(viewer, (name) => choose(name));
const recorder = new Recorder(() => sensors.find((each) => each.name === viewer.name)?.bus ?? "", (name) => playback.open(name));
const playback = new PlaybackPage(viewer, () => recorder.update());
viewer.drawOverview = (/** @type {number} */ unit) => playback.draw(unit);
const calibration = new CalibrationPage(viewer);
new Panels(() => viewer.layout());
/** @type {Sensor[]} */
let sensors = [];
let last = ""; // sensor that was shown before all of them
let reachable = true;
document.documentElement.dataset.painted = "0";

/** Update everything that is text. */
function read() {
  writeAddress();
  if (wall.open) document.title = "all sensors, tactiled";
  else {
    screen.read(viewer, reachable);
    viewer.write();
  }
  playback.read();
  for (const each of savers) each.disabled = !viewer.frame && each.ariaPressed !== "true"; // a film that runs can be ended
  byId("tare-undo").hidden = !canUndo(viewer.name) || playback.recording !== "";
}

/** @param {Status} status */
function onStatus(status) {
  tabs.mark(status.sensor, status.state);
  if (document.activeElement !== picker && picker.value !== status.method) picker.value = status.method;
}

/** Show a sensor, or all of them. @param {string} name */
function choose(name) {
  tabs.choose(name);
  document.body.classList.toggle("all", name === ALL);
  if (name === ALL) {
    playback.close();
    viewer.leave();
    wall.show(sensors);
  } else {
    last = name;
    wall.close();
    viewer.select(name);
    showSensor();
  }
  read();
}

/** Keep in the address what is shown, and how. */
function writeAddress() {
  if (!wall.open && !viewer.session) return; // the address says more than is known yet
  const query = new URLSearchParams(viewer.view.address(viewer.unit));
  playback.addTo(query);
  const hash = wall.open ? WALL + viewer.view.wallAddress : `#${encodeURIComponent(viewer.name)}${query.size ? `?${String(query).replaceAll("%3A", ":")}` : ""}`;
  if (hash === location.hash) return;
  try {
    window.history.replaceState(null, "", hash);
  } catch {
    // The address is a convenience only.
  }
}

/** Show what the list of sensors says of the one that is chosen. */
function showSensor() {
  const sensor = sensors.find((each) => each.name === viewer.name);
  if (!sensor) return;
  if (viewer.session && viewer.session.kinds.join() !== kindsOf(sensor).join()) viewer.reopen(sensor.name);
  screen.readings.about(sensor);
  recorder.read();
  const names = sensor.methods.includes(sensor.method) ? sensor.methods : [sensor.method, ...sensor.methods];
  if (names.join() !== [...picker.options].map((each) => each.value).join()) {
    picker.replaceChildren(...names.map((each) => new Option(methodTitle(each), each)));
    picker.value = sensor.method;
  }
  showMethod();
}

/** Show the method of a playback; live, a status says it. */
function showMethod() {
  const { session } = viewer;
  if (!(session instanceof PlaybackSession) || document.activeElement === picker) return;
  picker.value = session.method || (sensors.find((each) => each.name === viewer.name)?.method ?? picker.value);
}

/** Learn what does not change while the service runs. */
async function loadOffers() {
  const offered = await api.offered();
  recorder.offer(offered.has("/recordings"), sensors.some((each) => each.clock === REPLAYED));
  calibration.offer(offered.has("/sensors/{name}/calibration/session"));
  log.offer(offered.has("/events"));
  const demo = offered.has("/config") && await api.isDemo();
  calibration.isDemo = demo;
  byId("recordings-demo").hidden = !(demo && offered.has("/recordings"));
  const contacts = loadSetting(CONTACTS_KEY) ?? String(!demo); // the demo's are many, and lie over what is restored
  const shown = /** @type {HTMLInputElement} */ (byId("contacts-on"));
  if (contacts === "false") {
    shown.checked = false;
    viewer.showContacts(false);
  }
  shown.disabled = false;
  byId("demo").hidden = !demo || loadSetting(DEMO_KEY) !== null;
  await viewer.view.load();
}

/** @returns {string} the sensor that the address names; "" where nobody can say which */
function sensorInAddress() {
  try {
    return decodeURIComponent(location.hash.slice(1).split("?")[0]);
  } catch {
    return "";
  }
}

/** Take the sensor that the address names, or the first, where none is shown. */
function chooseSensor() {
  const all = sensors.length > 1 && (wall.open || (!viewer.name && location.hash.split("?")[0] === WALL));
  const requested = sensorInAddress();
  const known = sensors.find((each) => each.name === (viewer.name || requested)) ?? sensors[0];
  if (all && wall.open) wall.show(sensors);
  else if (all) choose(ALL);
  else if (known && (known.name !== viewer.name || wall.open)) choose(known.name);
  if (!sensors.length) notice("No sensor is configured.", true);
}

/** Poll the service. */
async function poll() {
  try {
    sensors = await api.sensors();
    reachable = true;
    tabs.update(sensors);
    if (!viewer.view.colormap) await loadOffers();
    chooseSensor();
    tabs.choose(wall.open ? ALL : viewer.name);
    showSensor();
    if (viewer.session?.stream.link === "closed") viewer.session.stream.retry();
    await Promise.all([recorder.update(), log.update()]);
  } catch (error) {
    reachable = !(error instanceof api.ApiError) || error.status !== 0;
    if (reachable) notice(messageOf(error), true);
    for (const name of tabs.names) tabs.mark(name, "unknown");
  }
  setTimeout(poll, POLL_MS);
}

controls(viewer, {
  screen,
  recorder,
  calibration,
  playback,
  sensors: () => tabs.names,
  choose,
  toggleWall: () => {
    if (sensors.length > 1) choose(wall.open ? last || sensors[0].name : ALL);
    else notice("There is one sensor only.");
  },
  nextTheme: theme(byId("theme"), () => {
    viewer.restyle();
    wall.restyle();
    calibration.restyle();
    series.chart.restyle();
  }),
});

byId("demo-close").addEventListener("click", () => {
  byId("demo").hidden = true;
  saveSetting(DEMO_KEY, "closed");
});
byId("skip").addEventListener("click", (event) => {
  event.preventDefault(); // an address is that of a sensor
  byId(/** @type {HTMLAnchorElement} */ (event.currentTarget).hash.slice(1)).focus();
});
window.addEventListener("hashchange", ({ newURL }) => { // a link was opened in this tab
  window.history.replaceState(null, "", newURL); // the page may have written its own already
  location.reload();
});
new ResizeObserver(([{ target }]) => document.body.style.setProperty("--head", `${target.clientHeight}px`)).observe(byId("head"));
new ResizeObserver(() => viewer.layout()).observe(byId("boxes"));
new ResizeObserver(() => wall.restyle()).observe(byId("wall"));
for (const id of ["section", "forces", "latencies", "kernel", "colorbar"]) {
  new ResizeObserver(() => {
    viewer.kernel.draw();
    viewer.refresh();
  }).observe(byId(id));
}
new IntersectionObserver((seen) => {
  viewer.sectionSeen = seen[seen.length - 1].isIntersecting;
  viewer.refresh();
}).observe(byId("section"));
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) viewer.refresh();
});
setInterval(read, READ_MS);
poll();
