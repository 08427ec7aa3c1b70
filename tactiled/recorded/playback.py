"""Any frame of a recording restored by itself, in whatever order.

Of the frames before it depends on the hysteresis alone, where the skin has a model of it.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from time import perf_counter
from typing import NamedTuple

import numpy as np

from tactiled.arrays import Flags, Floats, Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate.counts.tare import Zero, below_zero
from tactiled.chain import Chain, flag_warnings
from tactiled.contacts.detection import DetectedContact, Finder
from tactiled.contacts.felt import is_known, shares, unknown_cells
from tactiled.diagnostics.checks import CHECK_EVERY_FRAMES, CHECKS_IN_A_ROW
from tactiled.diagnostics.warning_codes import WarningCode, warning
from tactiled.frames import FrameWarning, RawFrame, SensorImage
from tactiled.geometry import tiling
from tactiled.recorded.frames import FrameFiles
from tactiled.recorded.noise import numbers_with_data, recorded_noise, shear_rest
from tactiled.units import FORCE_SCALES

HEADS_AT_ONCE = 4096  # in memory
PAST_EVERY_FRAMES, MAX_PASTS = 256, 512  # at which a state of the hysteresis is kept, and how many are
MAX_POINTS = 600  # of an overview: a point for each pixel or two of a chart


class Overview(NamedTuple):
    """Force on the raw images over a recording: of each piece of it the frames with the lowest and highest sum."""

    position_s: Floats  # (P,), ascending
    force: Floats  # (P,) N, or counts mm^2; NaN where too few taxels are known


def noise_frames(plan: SensorPlan, recorded: FrameFiles, count: int) -> tuple[int, ...]:
    """Numbers of those of the first `count` frames that noise and rest are measured from; none if configured."""
    if plan.calibration.noise_kpa and not plan.restores_shear:
        return ()
    return numbers_with_data(recorded.frame(plan.name, n) for n in range(count))


class Playback:
    """Restores the frames of one sensor of a recording, on one thread.

    Pressures are by `plan` and, if it was done before the first frame, the tare of `zero`. Drift is not tracked,
    and no faulty taxels are looked for. The noise is as configured, else measured from the first frames with data.
    """

    def __init__(self, plan: SensorPlan, zero: Zero, recorded: FrameFiles, noise_frames: Sequence[int]) -> None:
        """There must be a frame; the noise is measured from those of `noise_frames` unless it is configured."""
        self.plan, self.zero, self._recorded = plan, zero, recorded
        self._past: dict[int, Floats32] = {}  # of the hysteresis, before some frames
        self._next = 0  # frame that the hysteresis takes next
        tared = zero.time is not None and zero.time <= recorded.heads(plan.name, 0, 1)["time"][0]
        self.tared_at = zero.time if tared else None
        with_data = [recorded.frame(plan.name, n) for n in noise_frames]
        self.noise = recorded_noise(plan, with_data, zero.counts if tared else None)
        self._chain = Chain(plan, self.noise)
        self._chain.shear_rest = shear_rest(plan, with_data)
        self._calibrator = self._chain.calibrator
        if tared:
            self._chain.tare(zero)
        self._finder = Finder(plan.array, plan.cells)
        self._areas = tiling(plan.array).areas  # (N,) mm^2
        self._overview, self._overview_frames = Overview(np.empty(0), np.empty(0)), 0
        self._overview_numbers, self._overview_highest = np.empty(0, int), np.empty(0)  # frames, their readings

    def _pressure(self, number: int, frame: RawFrame) -> tuple[Floats32, Flags]:
        self._follow(number, frame)
        return self._chain.pressure(frame)

    def _follow(self, number: int, frame: RawFrame) -> None:
        """Bring the hysteresis to its state at this frame, as after playing all frames before it in order."""
        if (past := self._calibrator.past) is None:
            return
        if number == self._next - 1:
            return
        self._past.setdefault(0, past)
        if not 0 <= number - self._next < PAST_EVERY_FRAMES:
            self._next = max(n for n in self._past if n <= number)
            self._calibrator.resume(self._past[self._next])
        for n in range(self._next, number + 1):
            if n % PAST_EVERY_FRAMES == 0 and (past := self._calibrator.past) is not None:
                self._past[n] = past
                if len(self._past) > MAX_PASTS:
                    self._past = {at: self._past[at] for at in sorted(self._past)[::2]}
            each = frame if n == number else self._recorded.frame(self.plan.name, n)
            self._calibrator.follow(each.counts, each.flags)
        self._next = number + 1

    def image(self, number: int, method: str) -> SensorImage:
        """One frame restored; `arrived` is its position in the recording. ConfigError for an unknown method."""
        chain, frame = self._chain, self._recorded.frame(self.plan.name, number)
        chain.restorer(method)
        began = perf_counter()
        raw, flags = self._pressure(number, frame)
        if below_zero(raw, self.noise, 0.0).any():
            flags = chain.with_below_zero(raw, flags, max(self._highest(number), float(np.nanmax(raw))))
        done = chain.restore(raw, flags, method, frame=frame)
        warnings, microseconds = self.plan.warnings + flag_warnings(flags), (perf_counter() - began) * 1e6
        return chain.image(frame, raw, flags, done, microseconds=microseconds, warnings=warnings)

    def warnings(self, number: int, method: str) -> tuple[FrameWarning, ...]:
        """Warnings of one frame: those of a replay that this frame and the checks before it can show."""
        newest = number - number % CHECK_EVERY_FRAMES
        checked = range(newest, newest - CHECKS_IN_A_ROW * CHECK_EVERY_FRAMES, -CHECK_EVERY_FRAMES)
        codes: list[WarningCode] | None = None
        for n in checked:
            shows = self._check(n, method) if n >= 0 and codes != [] else ()
            codes = [code for code in (shows if codes is None else codes) if code in shows]
        return self.image(number, method).warnings + tuple(warning(code) for code in codes or ())

    def _check(self, number: int, method: str) -> tuple[WarningCode, ...]:
        image = self.image(number, method)
        return self._chain.check(image) if image.shares is None else ()  # what is unknown shows nothing

    def contacts(self, image: SensorImage) -> tuple[DetectedContact, ...]:
        """Contacts of an image, strongest first, numbered from 1: there is no frame before to follow them from."""
        spread, raw = partial(self._chain.deviation, image), image.method == "raw"
        found = self._finder(
            image.restored, image.cell_noise, image.unit, shares=image.shares, deviation=spread, blurred=raw
        )
        return tuple(replace(each, id=n) for n, each in enumerate(found, 1))

    def overview(self) -> Overview:
        """Force over the whole recording, as far as it was read; made anew where it has more frames now."""
        count = self._recorded.count(self.plan.name)
        if count != self._overview_frames:
            starts = np.unique(np.linspace(0, count, MAX_POINTS // 2, endpoint=False).astype(int)).tolist()
            pieces = pairwise([*starts, count])
            numbers = sorted({number for first, end in pieces for number in self._extremes(first, end)})
            positions = [self._recorded.heads(self.plan.name, n, 1)["position"][0] for n in numbers]
            force, highest = np.transpose([self._readings(n) for n in numbers])
            self._overview = Overview(np.array(positions), force)
            self._overview_numbers, self._overview_highest = np.array(numbers), highest
            self._overview_frames = count
        return self._overview

    def _extremes(self, first: int, end: int) -> tuple[int, int]:
        """The frames of a piece with the lowest and the highest sum."""
        heads, name = self._recorded.heads, self.plan.name
        starts = range(first, end, HEADS_AT_ONCE)
        totals = np.concatenate([heads(name, n, min(HEADS_AT_ONCE, end - n))["total"] for n in starts])
        return first + int(totals.argmin()), first + int(totals.argmax())

    def _readings(self, number: int) -> tuple[float, float]:
        """Raw force of a frame, NaN where a load may be on what is unknown, and its highest pressure."""
        raw, flags = self._pressure(number, self._recorded.frame(self.plan.name, number))
        share = shares(flags, self.plan.blur)
        whole = share is None or not unknown_cells(flags, self.plan.blur, share).any()
        known = whole and is_known(1 - np.isnan(raw).mean(), summed=True)
        force = float(np.nansum(raw.ravel() * self._areas)) * FORCE_SCALES[self.plan.unit] if known else np.nan
        return force, float(np.fmax.reduce(raw, axis=None))

    def _highest(self, number: int) -> float:
        """The highest reading up to a frame, as far as the overview has it."""
        if number >= self._overview_frames:
            self.overview()
        before = self._overview_highest[self._overview_numbers <= number]
        return float(np.fmax.reduce(before, initial=0.0))
