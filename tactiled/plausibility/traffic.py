"""Whether what comes on a bus is what a configuration expects; pure."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tactiled.arrays import Floats32, Ints
from tactiled.build import configured_file, make_array, make_calibration, make_codec
from tactiled.bus.arrivals import decoded
from tactiled.bus.assembler import RESTART_S
from tactiled.bus.batch import Batch
from tactiled.bus.codec import NO_SEQUENCE, Codec, setting_text, whole_counts
from tactiled.bus.grid_shape import alike_shapes
from tactiled.bus.router import Router
from tactiled.bus.sniff import SETTLED_FRAMES, Survey, mean_rate_hz, survey
from tactiled.config import schema
from tactiled.frames import Message, RawFrame
from tactiled.plausibility.settings import Finding

MAX_LOST_FRACTION = 0.01  # of an array's messages; as many may repeat others or be malformed
MIN_WRAPS = 2  # of a sequence number from the same highest to the same lowest: one may be a restart
REPEATED = "repeat others: the sequence number does not count frames, or two boards send on one id"
MAX_REST_FRACTION = 0.05  # of the full scale between no load and an unloaded array; fingertips of an iCub: 0.02
MIN_FRAMES_STUCK = 20  # a taxel with noise of a count repeats itself so often with a chance under 1e-8
MAX_LISTED = 8  # taxels


class BusReport(NamedTuple):
    """What came on one bus."""

    lines: list[str]  # one a sensor
    findings: list[Finding]
    others: Survey  # what belongs to no sensor


def bus_report(config: schema.Config, bus: str, messages: Sequence[Message], seconds: float) -> BusReport:
    """Hold the messages of `seconds` on a bus against the sensors that the configuration has there."""
    sensors = {name: each for name, each in config.sensor.items() if each.bus == bus}
    router = Router({name: make_codec(each) for name, each in sensors.items()})
    frames: defaultdict[str, list[RawFrame]] = defaultdict(list)
    for name, frame in router.push(Batch.of(messages)):
        frames[name].append(frame)
    report = BusReport([], [], survey(each for each in messages if (each.id, each.extended) not in router.ids))
    if not (messages or all(_waits(each.codec) for each in router.assemblers.values())):
        reason = f"no message in {seconds:g} s: nothing sends, or bit rate, channel or wiring are wrong"
        report.findings.append(Finding(f"bus.{bus}", "", reason))
    for name, assembler in router.assemblers.items():
        own, loss, sensor = frames[name], assembler.loss, sensors[name]
        codec, place = assembler.codec, f"sensor.{name}"
        came = Batch.of(each for each in messages if (each.id, each.extended) in codec.ids)
        malformed = _malformed(place, sensor, codec, came)
        if any(not each.flags.any() for each in own):
            lost = loss.lost - own[:SETTLED_FRAMES][-1].loss.lost
            rate = f"{mean_rate_hz([each.time for each in own]):.1f} frames a second"
            report.lines.append(f"{name}: {rate}, {lost} messages lost, {loss.malformed} malformed")
            wrap = _early_wrap(place, codec, came)
            # what did not fit is missing, too; a wrap makes frames look lost or repeated
            number, repeated = (0, 0) if wrap else (max(lost - loss.malformed, 0), loss.repeated)
            report.findings.extend(each for each in (malformed, wrap) if each)
            report.findings.extend(_frames(place, sensor, own, number, repeated))
        elif _waits(codec):
            report.lines.append(f"{name}: no frame: it waits until asked or started, and a check sends nothing")
        else:
            counts = f", {loss.lost} messages lost, {loss.malformed} malformed"
            report.lines.append(f"{name}: no complete frame{counts if loss.lost or loss.malformed else ''}")
            if messages:
                other = _other_settings(place, sensor, survey(messages), codec)
                report.findings.append(other or malformed or _silent(place, sensor, codec))
    return report


def _waits(codec: Codec) -> bool:
    return bool(codec.polling.polls or codec.polling.start)


def _malformed(place: str, sensor: schema.Sensor, codec: Codec, came: Batch) -> Finding | None:
    """What the codec cannot read of its ids' messages; a skin that is asked also sends other replies."""
    rows = decoded(codec, came, None)[1] if len(came) else came.ids
    if _waits(codec) or len(rows) <= MAX_LOST_FRACTION * len(came):
        return None
    first = next(iter(came[rows[:1]]))
    kind = "CAN FD" if first.fd else "classic"
    example = f"{kind}, id {first.id:#x}, {len(first.data)} bytes: {first.data[:8].hex(' ')}"
    reason = f"{100 * len(rows) / len(came):.1f} % of its messages do not fit the layout, the first {example}"
    change = "correct codec or array here, or the firmware; if another device sends them, change its id"
    pages = sensor.codec.name == "dbc"  # of multiplexed messages, without taxels, are no fault
    return Finding(f"{place}.codec", sensor.codec.name, f"{reason}: {change}", hint=pages)


def _early_wrap(place: str, codec: Codec, came: Batch) -> Finding | None:
    """Whether the sequence number begins again before the codec's modulus: newer frames look old or lost then."""
    arrivals, _ = decoded(codec, came, None)
    if codec.modulus is None or arrivals is None or (sequences := arrivals.readings.sequences) is None:
        return None
    low, high = int(sequences.min()), int(sequences.max())
    prompt = np.diff(arrivals.readings.times) < RESTART_S
    wraps = np.count_nonzero((np.diff(sequences) == low - high) & prompt)
    if not NO_SEQUENCE < low < high < low + codec.modulus - 1 or wraps < MIN_WRAPS:
        return None
    expected = f"{codec.modulus} numbers are expected"
    counts = f"its sequence number counts from {low} to {high} and begins again, and {expected}"
    own = f"set modulus = {high - low + 1} in a codec of your own"
    change = f"have the firmware count to {codec.modulus - 1}, or {own}"
    return Finding(f"{place}.codec", "", f"{counts}: {change}")


def _other_settings(place: str, sensor: schema.Sensor, result: Survey, codec: Codec) -> Finding | None:
    """Why no complete frame came, where the sensor's kind sends with other settings or another size."""
    configured = sensor.codec.settings
    for sender in result.senders:
        if sender.name == sensor.codec.name:
            settings = sender.match.settings.items()
            own = {key: getattr(configured, key, each) for key, each in settings}
            own = {key: list(each) if isinstance(each, tuple) else each for key, each in own.items()}
            others = {key: each for key, each in settings if own[key] != each}
            sends = f"no complete frame: {sender.match.description} sends"
            if others:
                change = ", ".join(f"{key} = {setting_text(key, each)}" for key, each in others.items())
                key = next(iter(others))
                return Finding(f"{place}.codec.{key}", setting_text(key, own[key]), f"{sends}: {change}")
            if set(sender.match.keys) & codec.ids:
                sizes = f"{sender.match.codec.segments} messages a frame, and {codec.segments} are expected"
                return Finding(f"{place}.array", "", f"{sends} {sizes}")
    return None


def _silent(place: str, sensor: schema.Sensor, codec: Codec) -> Finding:
    """That no complete frame came, and nothing says why."""
    ids = ", ".join(f"{id_:#x}" for id_, _ in sorted(codec.ids)[:MAX_LISTED])
    started = "; codec.start = true has the service start it" if hasattr(sensor.codec.settings, "start") else ""
    return Finding(f"{place}.codec", sensor.codec.name, f"no complete frame on ids {ids}{started}")


def _frames(
    place: str, sensor: schema.Sensor, frames: list[RawFrame], lost: int, repeated: int
) -> Iterator[Finding]:
    """Loss, repetition, pauses, counts at rest and taxels that do not move."""
    codec, calibration = make_codec(sensor), make_calibration(sensor, configured_file(sensor))
    for number, what in ((lost, "are lost"), (repeated, REPEATED)):
        if (share := number / (number + len(frames) * codec.segments)) > MAX_LOST_FRACTION:
            yield Finding(place, "", f"{100 * share:.1f} % of its messages {what}")
    pauses = np.diff([each.time for each in frames])
    if (longest := max(pauses, default=0.0)) > sensor.stale_after_s:
        typical = float(np.median(pauses))
        reason = f"one frame came {longest:.2g} s after the one before"
        if typical > sensor.stale_after_s:
            reason = f"frames come {typical:.2g} s apart"
        yield Finding(f"{place}.stale_after_s", f"{sensor.stale_after_s:g}", reason)
    if not whole_counts(codec):
        return
    counts = np.array([each.counts for each in frames if not each.flags.any()], np.float32)
    level = np.median(counts, axis=0)
    level[list(calibration.dead)] = np.nan
    no_load = calibration.no_load if calibration.no_loads is None else calibration.no_loads
    rest = float(np.nanmedian(level))
    if abs(np.nanmedian(level - no_load)) > MAX_REST_FRACTION * codec.full_scale:
        reason = f"half of the taxels read {rest:g} or more; if nothing touches them, set no_load = {rest:g}"
        yield Finding(f"{place}.calibration.no_load", f"{np.median(no_load):g}", reason)
    if grid := _other_grid(place, sensor, counts):
        yield grid
    if len(counts) >= MIN_FRAMES_STUCK and (stuck := _stuck(counts, level, rest, codec)).size:
        listed = ", ".join(map(str, stuck[:MAX_LISTED])) + ", ..." * (stuck.size > MAX_LISTED)
        reason = f"never change: taxels {listed}: list them if they do not work"
        yield Finding(f"{place}.calibration.dead", str(list(calibration.dead)), reason)


def _other_grid(place: str, sensor: schema.Sensor, counts: Floats32) -> Finding | None:
    """Whether what presses on a grid shows other rows and columns."""
    shape = make_array(sensor).shape
    if shape is None or 1 in shape or not (shapes := alike_shapes(counts, [counts.shape[1]])) or shape in shapes:
        return None
    rows, columns = shapes[0]
    reason = f"what presses on it spreads over neighbours as on {rows} x {columns}"
    swapped = ": rows and columns are swapped" if shapes[0] == shape[::-1] else ""
    return Finding(f"{place}.array", f"{shape[0]} x {shape[1]}", f"{reason}{swapped}")


def _stuck(counts: Floats32, level: Floats32, rest: float, codec: Codec) -> Ints:
    """Taxels that never change where the others have noise, or at an end of the scale; `level` NaN: left out."""
    still = (np.ptp(counts, axis=0) == 0) & np.isfinite(level)
    if float(np.median(counts.std(axis=0))) >= 1:
        return np.flatnonzero(still)
    loaded = abs(level - rest) > MAX_REST_FRACTION * codec.full_scale
    return np.flatnonzero(still & np.isin(level, codec.ends) & loaded)
