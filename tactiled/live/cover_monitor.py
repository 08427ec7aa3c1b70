"""The cover's thickness from a live sensor's own contacts, judged now and then in a process of its own.

A cover thicker than configured leaves no misfit in any frame: only contacts together tell it, as in a blind fit.
"""

from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from tactiled.arrays import Flags, Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate.cover.blind import MAX_GAIN_ERROR, Profiles, add_contacts
from tactiled.calibrate.cover.contact_frames import CLEAR, MAX_NEAR_FRAMES
from tactiled.calibrate.cover.fit import CoverFit
from tactiled.calibrate.cover.recorded_presses import gain_errors
from tactiled.diagnostics.warning_codes import cover_warning
from tactiled.frames import SATURATED, FrameWarning
from tactiled.processes import start
from tactiled.restore.noise import detection_threshold

EVERY_FRAMES = 8  # is looked at
MIN_TAXELS = 0.9  # of all, that count
SAME_SHAPE = 0.7  # correlation of two successive frames, from which on they show one contact
MIN_SNR = 100.0  # peak over noise of a frame that counts; with 200, 240 s of the tour had too few under 3.9 mm
CONTACTS = 6  # for the first search; a search uses the steepest ones, as soft contacts show nothing
PAUSE = 100.0  # times the duration of the last search: searches take at most 1 % of a core
# Half of the 95 % interval of the thickness's logarithm, at least: what presses a live sensor comes again, so that
# contacts share errors which their scatter does not show. Of 12 to 15 sensors on the tour they were 2 to 3.5 %.
SHARED_ERROR = 0.07
MIN_HALF_INTERVALS = 1.51  # between fitted and configured thickness for a warning: 3 deviations
MIN_MISMATCH = 0.15  # relative, for a warning; a Poisson's ratio of 0.45 for 0.48 makes 0.11
ZERO_FRAMES = 32  # that are looked at, and over which the zero before a contact is averaged


class Steep(NamedTuple):
    """The steepest moment of a contact."""

    steepness: float  # largest step between neighbours over the peak
    frames: list[Floats32]  # over the zero and the noise, NaN where unknown
    place: int  # of the moment in these
    zero_variance: float  # over the noise's


class CoverMonitor:
    """Warns of a cover that contacts contradict; `search` may run on another thread than the rest."""

    def __init__(self, plan: SensorPlan) -> None:
        self._plan, kernel = plan, plan.kernel
        errors = gain_errors(plan.calibration, plan.array.size)
        self._usable = (errors <= MAX_GAIN_ERROR).reshape(plan.array.frame_shape)
        self._gain_error = float(np.median(errors))
        is_solved_grid = min(plan.array.shape or (1,)) > 1 and kernel.model != "measured"
        self._judges = is_solved_grid and self._usable.mean() >= MIN_TAXELS
        self._frames, self._due, self._began = 0, -np.inf, 0.0
        self._resets = self._resets_before = 0  # before the search under way
        self._running: Connection | None = None
        self.reset()

    def reset(self) -> None:
        """Forget every contact: their zeros no longer hold."""
        self._resets += 1
        self._before = np.zeros(self._plan.array.frame_shape, np.float32)
        self._near: list[Floats32] = []  # of the present contact; replaced, never changed, as _waiting
        self._zero, self._zero_frames = np.zeros_like(self._before), 0
        self._best: Steep | None = None
        self._waiting: list[Steep] = []
        self._profiles: Profiles | None = None
        self.warning: tuple[FrameWarning, ...] = ()

    def observe(self, raw: Floats32, flags: Flags, noise_kpa: float) -> None:
        """Take a frame in kPa. A lift or a new shape ends a contact; its steepest frame then waits."""
        self._frames += 1
        if not self._judges or self._frames % EVERY_FRAMES or (flags & SATURATED).any():
            return
        usable = self._usable & (flags == 0)
        frame, before = np.where(usable, raw / np.float32(noise_kpa), np.float32(0)), self._before
        alike = np.vdot(frame, before) > SAME_SHAPE * np.linalg.norm(frame) * np.linalg.norm(before)
        self._before, touched = frame, frame.max() > CLEAR
        if not (touched and alike):
            if self._best:
                self._waiting = sorted([*self._waiting, self._best], key=lambda each: each.steepness)[-CONTACTS:]
            self._best, self._near = None, []
        over = frame - self._zero
        if over.max() < detection_threshold(1.0, frame.size):  # no contact: zeros may drift
            self._zero_frames = min(self._zero_frames + 1, ZERO_FRAMES)
            self._zero = self._zero + over / np.float32(self._zero_frames)
        if touched:
            self._near = [*self._near, np.where(usable, over, np.float32(np.nan))][-2 * MAX_NEAR_FRAMES - 1 :]
            place = len(self._near) // 2
            middle = np.nan_to_num(self._near[place])
            steepness = float(
                max(np.abs(np.diff(middle, axis=axis)).max(initial=0.0) for axis in (0, 1)) / middle.max()
            )
            if middle.max() > MIN_SNR and (self._best is None or steepness > self._best[0]):
                self._best = Steep(steepness, self._near, place, 1 / max(self._zero_frames, 1))

    def search(self, now: float) -> None:
        """Judge the contacts that wait, if it is time, `now` (s); raises what the last search raised."""
        if self._running:
            if not self._running.poll():
                return
            self._due, running, self._running = now + PAUSE * (now - self._began), self._running, None
            outcome, error = running.recv()
            if error:
                raise error
            self._profiles, self.warning = outcome[0], self._judged(outcome[1])
            if self._resets != self._resets_before:  # checked last: a reset may come at any time
                self._profiles, self.warning = None, ()
        elif now >= self._due and len(self._waiting) >= (1 if self._profiles else CONTACTS):
            self._began, self._resets_before = now, self._resets
            contacts = [(np.stack(each.frames), each.place, each.zero_variance) for each in self._waiting]
            self._waiting = []
            skin = self._plan.kernel.stack, self._plan.array
            self._running = start(add_contacts, self._profiles, contacts, self._gain_error, *skin)

    def _judged(self, fit: CoverFit) -> tuple[FrameWarning, ...]:
        """A warning where a fit contradicts the configured thickness."""
        half = float(np.hypot(np.log(fit.interval[1] / fit.interval[0]) / 2, SHARED_ERROR))
        if fit.reason or abs(np.log(fit.factor)) <= max(MIN_HALF_INTERVALS * half, np.log(1 + MIN_MISMATCH)):
            return ()
        low, high = np.round(fit.thickness_mm * np.exp([-half, half]), 3).tolist()
        return (cover_warning(fit.thickness_mm, self._plan.kernel.stack.depth, (low, high)),)
