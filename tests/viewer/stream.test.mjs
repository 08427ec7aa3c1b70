import assert from "node:assert/strict";
import test, { beforeEach } from "node:test";

import { csvText } from "../../tactiled/web/static/export/export_csv.js";
import { Plane } from "../../tactiled/web/static/maps/geometry.js";
import { npy } from "../../tactiled/web/static/export/npy.js";
import { provenance } from "../../tactiled/web/static/export/provenance.js";
import { Session } from "../../tactiled/web/static/wire/session.js";
import { HEADER_BYTES, RAW, RESTORED, SHEAR, TRACTION, kindsOf, packet, parse } from "../../tactiled/web/static/wire/wire.js";

/** A message as the service packs it; `over` replaces parts of the header. */
function message(kind, sequence, { rows = 1, columns = 2, values = [1, NaN], flags = [], over = {} } = {}) {
  const buffer = new ArrayBuffer(HEADER_BYTES + 4 * values.length + flags.length);
  const view = new DataView(buffer);
  for (const [at, each] of [..."TCTL"].entries()) view.setUint8(at, each.charCodeAt(0));
  view.setUint8(4, over.version ?? 1);
  view.setUint8(5, kind);
  view.setUint16(6, rows, true);
  view.setUint16(8, columns, true);
  view.setUint16(10, flags.length, true);
  view.setBigUint64(16, BigInt(sequence), true);
  view.setFloat64(24, over.timestamp ?? sequence / 10, true);
  view.setFloat64(32, over.sent ?? Date.now() / 1000, true);
  view.setUint32(60, over.method ?? 3, true);
  values.forEach((each, i) => view.setFloat32(HEADER_BYTES + 4 * i, each, true));
  new Uint8Array(buffer).set(flags, HEADER_BYTES + 4 * values.length);
  return buffer;
}

const decode = (buffer) => parse(new Uint8Array(buffer), packet());

test("a message that is none of the service's is refused with the reason", () => {
  const good = message(RAW, 1, { flags: [0, 8] });
  assert.deepEqual([...decode(good).flags], [0, 8]);
  const bad = good.slice(0);
  new DataView(bad).setUint8(0, 0);
  for (const [buffer, reason] of [
    [good.slice(0, 60), /has no header/], [good.slice(0, -1), /ends after/], [bad, /TCTL/],
    [message(RAW, 1, { over: { version: 2 } }), /version 2/],
  ]) assert.throws(() => decode(buffer), { name: "RangeError", message: reason });
});

test("one packet takes messages of every size and kind", () => {
  const into = packet();
  const take = (...of) => parse(new Uint8Array(message(...of)), into);
  assert.deepEqual([...take(RESTORED, 2 ** 33).values], [1, NaN]);
  assert.equal(into.sequence, 2 ** 33);
  assert.deepEqual([...take(SHEAR, 1, { values: [1, 2, 3, 4] }).shear], [1, 2, 3, 4]);
  assert.equal(into.values.length, 0);
  assert.equal(take(RAW, 2, { flags: [1, 2] }).shear.length, 0);
  assert.deepEqual([...take(RAW, 2, { flags: [4, 8] }).flags], [4, 8]);
});

test("an .npy of anything but rows of 32-bit numbers is refused", () => {
  const file = (type) => {
    const header = `{'descr': '${type}', 'fortran_order': False, 'shape': (2,)}\n`.padEnd(118);
    return new Uint8Array([...Array(8).fill(0), 118, 0, ...new TextEncoder().encode(header), 0, 0, 128, 63, 0, 0,
      0, 64]).buffer;
  };
  assert.deepEqual([...npy(file("<f4"))], [1, 2]);
  assert.throws(() => npy(file("<f8")), RangeError);
});

/** Stands for the browser's: remembers what was sent and delivers what the test wants. */
class FakeSocket {
  static all = [];

  constructor(url) {
    this.url = url;
    this.sent = [];
    FakeSocket.all.push(this);
  }

  static get last() {
    return FakeSocket.all.at(-1);
  }

  send(text) {
    this.sent.push(JSON.parse(text));
  }

  close() {}

  deliver(...messages) {
    for (const data of messages) this.onmessage({ data: data instanceof ArrayBuffer ? data : JSON.stringify(data) });
  }
}

beforeEach(() => {
  FakeSocket.all = [];
  globalThis.WebSocket = FakeSocket;
  Date.now = () => 1e12;
  Object.defineProperty(globalThis, "performance", { value: { now: () => 1000 }, configurable: true });
  globalThis.location = { href: "http://127.0.0.1/" };
  for (const name of ["setTimeout", "setInterval"]) globalThis[name] = () => 0; // nothing comes by time
});

const plane = new Plane({
  shape: [1, 2], positions_mm: [[0, 0], [1, 0]], pitch_mm: 1, aperture: "square", aperture_mm: 1,
  raw: { rows: 1, columns: 2 }, restored: { rows: 1, columns: 2, cell_mm: 1, origin_mm: [0, 0], mask: null }, areas_mm2: null,
});
const status = (sequence, more = {}) => ({
  type: "status", state: "live", method: "wiener", ran: "wiener", sequence, timestamp: sequence / 10, ...more,
});
const frame = (sequence, over) =>
  [message(RAW, sequence, { flags: [0, 1], over }), message(RESTORED, sequence, { over })];

/** A session, its socket, and what it reported; it is painted after each frame. */
function watch(shear = false) {
  const events = [];
  const session = new Session("palm", plane, kindsOf({ shear, traction: shear }), true, shear, {
    onFrame: (each) => {
      events.push(each.sequence);
      session.painted();
    },
    onStatus: () => {}, onLink: () => {}, onContacts: () => {}, onOtherShape: () => events.push("other shape"),
  });
  const socket = FakeSocket.last;
  socket.onopen();
  return { session, socket, events };
}

test("a frame counts once both of its images came, and the next is requested then", () => {
  const { socket, events } = watch();
  assert.match(socket.url, /^ws:.*palm\/stream\?kinds=raw,restored&.*contacts=1/);
  assert.equal(socket.sent.length, 2);
  const [raw, restored] = frame(7);
  socket.deliver(raw, message(RESTORED, 6));
  assert.deepEqual([events, socket.sent.length], [[], 2]);
  socket.deliver(restored);
  assert.deepEqual([events, socket.sent.length], [[7], 3]);
});

test("a still image keeps its own method, and details of the status nearest in time or none", () => {
  const { session, socket } = watch();
  socket.deliver(...frame(10, { method: 2 }), status(10), ...frame(12, { method: 3 }), status(13));
  socket.deliver(...frame(40, { method: 6 }));
  assert.equal(session.statusOfFrame.sequence, 13);
  session.pause(true);
  const at = (back) => {
    session.show(back);
    return [session.frame.method, session.statusOfFrame?.sequence];
  };
  assert.deepEqual([at(0), at(1), at(2), at(9)], [["nnls", undefined], ["wiener", 13], ["raw", 10], ["raw", 10]]);
  socket.deliver(...frame(41), status(41));
  assert.equal(session.history.length, 3);
  session.pause(false);
  socket.deliver(...frame(42));
  assert.equal(session.frame.sequence, 42);
});

test("a pause stands at the frame whose contacts have come, if that is of late", () => {
  const { session, socket } = watch();
  const contacts = (sequence, found) =>
    ({ type: "contacts", unit: "kPa", sequence, timestamp: sequence / 10, contacts: found });
  socket.deliver(...frame(10), contacts(10, [{}]), ...frame(11));
  session.pause(true);
  assert.deepEqual([session.frame.sequence, session.back], [10, 1]);
  session.pause(true);
  session.show(0);
  assert.equal(session.frame.sequence, 11);
  for (const [sequence, message] of [[13, contacts(11, [{}])], [14, contacts(13, [])]]) {
    session.pause(false);
    socket.deliver(message, ...frame(sequence));
    session.pause(true);
    assert.equal(session.frame.sequence, sequence); // 200 ms later, and where there are none
  }
});

test("contacts that come during a pause belong to its frames, and it stands at one that has them", () => {
  const { session, socket } = watch();
  const contacts = (timestamp) => ({ type: "contacts", unit: "kPa", sequence: 10 * timestamp, timestamp, contacts: [{}] });
  socket.deliver(...frame(10), ...frame(11), ...frame(12));
  session.pause(true);
  assert.deepEqual([session.frame.sequence, session.contacts.at(session.frame.timestamp)], [12, null]);
  for (const [came, stands] of [[1.1, 11], [1.2, 12], [1.3, 12]]) {
    socket.deliver(contacts(came));
    assert.equal(session.frame.sequence, stands);
    assert.equal(session.contacts.at(session.frame.timestamp).sequence, stands);
  }
  session.show(2);
  socket.deliver(contacts(1.1));
  assert.deepEqual([session.frame.sequence, session.contacts.at(session.frame.timestamp)], [10, null]); // none of another
});

test("frames of another run or another shape are not mixed with those before", () => {
  const { session, socket, events } = watch();
  socket.deliver(...frame(10), ...frame(11), ...frame(11 + 601));
  assert.equal(session.history.length, 1);
  for (const other of [{ columns: 1, values: [1] }, { rows: 2, columns: 1 }]) {
    socket.deliver(message(RAW, 800, { ...other, flags: [0] }), message(RESTORED, 800, other));
    assert.equal(events.pop(), "other shape");
  }
  socket.deliver(...frame(9));
  assert.deepEqual([events.at(-1), session.history.length], ["other shape", 1]); // it was restarted
});

test("a restart that only a status or a frame dropped meanwhile told of is noticed when a paused page goes on", () => {
  for (const told of [[status(null)], [status(3)], frame(3)]) {
    const { session, socket, events } = watch();
    socket.deliver(...frame(10));
    session.pause(true);
    socket.deliver(...told, ...frame(11));
    session.pause(false);
    socket.deliver(...frame(12));
    assert.deepEqual(events, [10, "other shape"]);
  }
});

test("a live frame that waited is held back and replaced, and shown where the sensor falls silent", () => {
  const { session, socket, events } = watch();
  socket.deliver(status(1), ...frame(1), ...frame(2, { sent: Date.now() / 1000 - 1 }));
  assert.deepEqual([events, session.frame.sequence, socket.sent.length], [[1], 1, 4]);
  socket.deliver(status(2, { state: "stale" }));
  assert.deepEqual([events, session.frame.sequence], [[1, 2], 2]);
});

test("shear comes with its frame and into the CSV", () => {
  const { session, socket } = watch(true);
  socket.deliver(...frame(3), message(SHEAR, 3, { values: [5, NaN, -6, NaN] }));
  assert.equal(session.frame, null);
  socket.deliver(message(TRACTION, 3, { values: [0.5, NaN, -0.25, NaN] }));
  const lines = csvText(plane, session.frame, provenance("palm", session.frame, null, "live")).split("\n");
  assert.deepEqual(lines.slice(0, 3), ["# sensor: palm", "# frame: 3", "# time: 1970-01-01T00:00:00.300Z"]);
  assert.deepEqual(lines.filter((each) => each[0] !== "#").slice(0, -1), [
    "image,row,column,x_mm,y_mm,kpa,flags,shear_x_counts,shear_y_counts,shear_x_kpa,shear_y_kpa", "raw,0,0,0,0,1,0,5,-6,,",
      "raw,0,1,1,0,,1,,,,",
    "restored,0,0,0,0,1,,,,0.5,-0.25", "restored,0,1,1,0,,,,,,",
  ]);
  session.ask(false, false);
  assert.doesNotMatch(FakeSocket.last.url, /shear|traction|contacts/);
});

test("a connection that sends what nobody requested is closed and retried, later each time", () => {
  const { session, socket } = watch();
  socket.deliver(message(SHEAR, 1, { values: [1, 2, 3, 4] }));
  assert.deepEqual([session.stream.link, session.stream.reason], ["closed",
    "an image of kind 2 was not requested"]);
  const waits = [session.stream.retryAt - performance.now()];
  for (let i = 0; i < 5; i += 1) {
    session.stream.retry();
    FakeSocket.last.onclose({ reason: "" });
    waits.push(session.stream.retryAt - performance.now());
  }
  assert.ok(waits[0] < 700 && waits[5] > 6000 && waits[5] < 10_000, waits);
  session.stop();
  session.stream.retry();
  assert.equal(FakeSocket.all.length, 6);
});
