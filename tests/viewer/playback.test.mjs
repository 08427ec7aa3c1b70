import assert from "node:assert/strict";
import test from "node:test";

import { positionText } from "../../tactiled/web/static/shell/format.js";
import { Plane } from "../../tactiled/web/static/maps/geometry.js";
import { PlaybackClock, rateOf, recordingName, splitFrames, stepOf } from "../../tactiled/web/static/playback/playback_clock.js";
import { PlaybackSession } from "../../tactiled/web/static/playback/playback_session.js";
import { areasOf, curvesOf } from "../../tactiled/web/static/playback/recorded_series.js";
import { messageBytes } from "../../tactiled/web/static/wire/wire.js";

test("a position goes on at the chosen speed while it plays, from where it was", () => {
  const clock = new PlaybackClock();
  clock.seek(5, 1000);
  assert.equal(clock.at(3000), 5);
  clock.play(true, 3000);
  assert.equal(clock.at(4000), 6);
  clock.setSpeed(0.1, 4000);
  assert.equal(clock.at(14_000), 7);
  clock.seek(2, 14_000);
  assert.equal(clock.at(24_000), 3);
  clock.play(false, 24_000);
  assert.equal(clock.at(99_000), 3);
});

test("no more frames are fetched than a screen shows", () => {
  for (const [frames, duration, speed, step] of [
    [60_000, 600, 1, 1], [60_000, 600, 0.1, 1], [60_000, 600, 10, 16], [600_000, 600, 1, 16], [1, 0, 10, 166],
  ]) assert.equal(stepOf(frames, duration, speed), step, `${frames} in ${duration} s at ${speed}`);
});

test("a recording of which one frame was read has no rate yet", () => {
  assert.equal(rateOf({ frames: 1, duration_s: 0.002 }), NaN);
  assert.equal(rateOf({ frames: 101, duration_s: 1 }), 100);
});

test("positions have minutes, and hours where there are any", () => {
  for (const [seconds, text] of [
    [0, "0:00.0"], [59.96, "1:00.0"], [600, "10:00.0"], [3725.04, "1:02:05.0"], [NaN, "\u2013"],
  ]) assert.equal(positionText(seconds), text);
});

test("a file's name becomes one that the service takes", () => {
  for (const [file, name] of [
    ["grasp.log", "grasp.log"], ["left hand (2).LOG", "left-hand-2-.log"], ["a.b.asc.gz", "a-b.asc.gz"],
    ["../../etc.blf", "etc.blf"], ["grasp", "grasp"], [".log", "recording.log"],
    [`${"x".repeat(200)}.blf`, `${"x".repeat(100)}.blf`],
  ]) assert.equal(recordingName(file), name);
});

test("a request of before does not end playback where it fails", async () => {
  const plane = new Plane({
    shape: [1, 1], positions_mm: [[0, 0]], pitch_mm: 1, aperture: "square", aperture_mm: 1,
    raw: { rows: 1, columns: 1 }, restored: { rows: 1, columns: 1, cell_mm: 1, origin_mm: [0, 0], mask: null }, areas_mm2: null,
  });
  let tick, answer;
  globalThis.requestAnimationFrame = (each) => { tick = each; };
  globalThis.fetch = () => new Promise((resolve) => { answer = resolve; });
  const session = new PlaybackSession("palm", plane, [0, 1], false, false, { name: "grasp.log", frames: 9 }, {
    onFrame() {}, onChange: () => assert.fail("it said so"),
  });
  tick(0);
  session.show(0);
  session.pause(false);
  answer(new Response(null, { status: 404 }));
  await new Promise(setImmediate);
  assert.ok(!session.paused);
});

test("an answer is taken apart into the messages of each frame", () => {
  const message = (kind, flags) => {
    const bytes = new Uint8Array(64 + 4 * 6 * (kind === 2 ? 2 : 1) + flags);
    const view = new DataView(bytes.buffer);
    bytes[5] = kind;
    for (const [at, value] of [[6, 2], [8, 3], [10, flags]]) view.setUint16(at, value, true);
    return bytes;
  };
  const frame = [message(0, 6), message(1, 0), message(2, 0)];
  const answer = Uint8Array.from([...frame, ...frame].flatMap((each) => [...each]));
  assert.deepEqual(splitFrames(answer, 3, messageBytes), [frame, frame]);
  assert.throws(() => splitFrames(answer.subarray(0, answer.length - 100), 3, messageBytes), RangeError);
});

test("of a series force and peak of each area can be drawn, once they are measured", () => {
  const total = { name: "total", force: [1, null], peak: [10, 20] };
  const heel = { name: "heel", force: [0.5, 0.7], peak: [9, 8] };
  const series = { unit: "counts", position_s: [0, 0.1], total: null, regions: [] };
  assert.deepEqual([areasOf(series), curvesOf(series, {})], [[], []]);
  const curves = curvesOf({ ...series, total, regions: [heel] }, { heel: { quantity: "peak", above: 8.5, below: 8 }, toe: null });
  assert.deepEqual(curves.map(({ above }) => above), [[], [], [0], [0]]);
  const repeated = { name: "heel", force: [0, 2, 1, null, 0.4, 0.5, 1.1, 3], peak: [] };
  const [, , , { above }] = curvesOf({ ...series, total, regions: [repeated] }, { heel: { quantity: "force", above: 1, below: 0.5 } });
  assert.deepEqual(above, [1, 6]); // 0.5 is not below 0.5, 0.4 is
  assert.deepEqual(curves.map(({ title, unit, y }) => [title, unit, y]), [
    ["total, force", "counts·mm²", [1, null]], ["total, peak", "counts", [10, 20]],
    ["heel, force", "counts·mm²", [0.5, 0.7]], ["heel, peak", "counts", [9, 8]],
  ]);
});
