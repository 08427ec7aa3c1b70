/** Recordings of a bus: begin, end, list, fetch, delete. @module */

import * as api from "../wire/api.js";
import { byId, confirmed, element, setText } from "../shell/dom.js";
import { byteText, dateText, duration } from "../shell/format.js";
import { notice } from "../shell/notice.js";
import { withToken } from "../wire/token_dialog.js";

/** @import { Recording } from "../wire/api.js" */

export class Recorder {
  /**
   * @param {() => string} bus of the sensor that is watched; "" for none
   * @param {(name: string) => void} play play a recording
   */
  constructor(bus, play) {
    this._bus = bus;
    this._play = play;
    this._button = /** @type {HTMLButtonElement} */ (byId("record"));
    this._list = byId("recordings");
    /** @type {Recording[]} */
    this._recordings = [];
    this._shownKey = "";
    this.offered = false;
    this._records = this._replayed = false;
    this._button.addEventListener("click", () => this.toggle());
  }

  /**
   * @param {boolean} offered whether the service has a folder of recordings
   * @param {boolean} replayed whether it replays one, and has no bus to record
   */
  offer(offered, replayed) {
    this.offered = offered;
    this._replayed = replayed;
    this._records = offered && !replayed;
    this._button.hidden = !this._records;
    byId("recordings-hint").hidden = offered || replayed;
    byId("recording-add").hidden = !offered;
    byId("recordings-replay").hidden = !replayed;
  }

  /** Look at the folder. */
  async update() {
    if (!this.offered) return;
    const at = (/** @type {Recording} */ { running, modified }) => (running ? Infinity : modified ?? 0);
    this._recordings = (await api.recordings()).sort((one, other) => at(other) - at(one) || 0);
    this.read();
  }

  /** @returns {Recording|undefined} what runs on the bus that is watched */
  get _running() {
    const bus = this._bus();
    return this._recordings.find((each) => each.running && each.bus === bus);
  }

  /** Begin to record the bus that is watched, or end it. */
  async toggle() {
    const bus = this._bus();
    if (!this._records) notice(this._replayed ? "This is a replay: no bus is open to record." : "To record, name a folder: server.recordings.", true);
    if (!this._records || !bus) return;
    const running = this._running;
    if (running) await this._stop(running.name);
    else if (await withToken(() => api.startRecording(bus), "Not recorded")) notice(`Recording ${bus}.`);
    await this._refresh();
  }

  /** @param {string} name */
  async _stop(name) {
    await withToken(async () => {
      const recording = await api.stopRecording(name);
      const complete = recording.bytes !== null && recording.error === null;
      notice(complete ? `Recorded: ${name}.` : `${name}: ${describe(recording)}.`, !complete, complete ? { name: "Open", run: () => this._play(name) } : null);
    }, "Recording not ended");
  }

  async _refresh() {
    await this.update().catch(() => undefined); // the next look says what is wrong
  }

  /** Bring button and list up to date. */
  read() {
    const running = this._running;
    this._button.setAttribute("aria-pressed", String(Boolean(running)));
    this._button.disabled = !this._bus();
    setText(this._button, running ? "Stop" : "Record");
    const shown = JSON.stringify(this._recordings.map((each) => [each.name, each.running, each.error]));
    if (shown !== this._shownKey) {
      this._shownKey = shown;
      this._fill();
    }
    for (const [i, each] of this._recordings.entries()) {
      setText(/** @type {Element} */ (this._list.children[i].querySelector(".sub")), describe(each));
    }
    byId("recordings-none").hidden = !this.offered || this._recordings.length > 0;
  }

  /** Make the list again; what had the focus keeps it, or gives it to what stands there now. */
  _fill() {
    const focused = document.activeElement;
    const row = focused?.closest("#recordings li");
    const place = row ? [...this._list.children].indexOf(row) : -1;
    const name = row?.firstChild?.textContent;
    this._list.replaceChildren(...this._recordings.map((each) => this._row(each)));
    if (!focused || !row) return;
    const index = this._recordings.findIndex((each) => each.name === name);
    const now = this._list.children[index < 0 ? Math.min(place, this._recordings.length - 1) : index];
    const at = [...row.querySelectorAll(focused.localName)].indexOf(focused);
    const heir = now?.querySelectorAll(focused.localName)[at] ?? now?.querySelector("button:last-child") ?? this._button;
    /** @type {HTMLElement} */ (heir).focus();
  }

  /** @param {Recording} recording @returns {HTMLElement} */
  _row(recording) {
    const { name, running } = recording;
    const title = element(running ? "b" : "a", "", name);
    if (title instanceof HTMLAnchorElement) {
      title.href = api.recordingUrl(name);
      title.download = name;
      title.title = `Download ${name}`;
    }
    const button = element("button", "", running ? "Stop" : "Delete");
    button.type = "button";
    button.title = running ? `Stop recording ${name}` : `Delete ${name}`;
    button.addEventListener("click", async () => {
      if (!running && !confirmed(button)) return;
      if (running) await this._stop(name);
      else if (await withToken(() => api.deleteRecording(name), "Not deleted")) notice(`Deleted: ${name}.`);
      await this._refresh();
    });
    const play = element("button", "", "Open");
    play.type = "button";
    play.title = `Open ${name} to play it`;
    play.hidden = running;
    play.addEventListener("click", () => this._play(name));
    return element("li", "", title, element("span", "end", play, button), element("span", "sub"));
  }
}

/** @param {Recording} recording @returns {string} */
function describe(recording) {
  const size = recording.bytes === null ? "file moved or removed" : byteText(recording.bytes);
  const messages = recording.messages === null ? "" : `, ${recording.messages} messages`;
  const when = recording.modified ? `${dateText(recording.modified, "short")}, ` : "";
  const length = recording.duration_s === null ? "" : `${duration(recording.duration_s)}, `;
  const state = recording.running ? `recording ${recording.bus}, ` : when;
  return `${state}${length}${size}${messages}${recording.error ? `, ended early: ${recording.error}` : ""}`;
}
