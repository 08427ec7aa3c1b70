"""The noise of a sensor's taxels: of a recording before its first image, of a bus from the first frames on."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from tactiled.arrays import Floats32
from tactiled.build import SensorPlan
from tactiled.bus.codec import Codec
from tactiled.bus.router import Router
from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.core import readings
from tactiled.diagnostics.checks import NOISE_RATIO
from tactiled.diagnostics.warning_codes import warning
from tactiled.frames import UNKNOWN, FrameWarning, RawFrame
from tactiled.restore.noise import estimate
from tactiled.units import Unit

if TYPE_CHECKING:
    from tactiled.bus.recording import Recording

NOISE_FRAMES = 32  # from which the noise is measured, to 3 % on 64 taxels
NOISE_PAUSE_FRAMES = 992  # until it is measured again: every 10 s at 100 Hz
MAX_NOISE_SEARCH = 1000  # frames of a recording from which those with data are taken
MAX_SEARCHED_MESSAGES = 1_000_000  # of a recording, which may have no frame


class Noise:
    """Standard deviation of a taxel, in `unit`: as configured, else of the first frames; measured now and then."""

    def __init__(self, calibration: Calibration, unit: Unit, before: "Noise | None" = None) -> None:
        """`before` is of the same array with another gain: its noise in counts is the start."""
        self._unit = unit
        self._floor, self._configured = calibration.floor_kpa, calibration.noise_kpa
        self.kpa: float = self._configured or self._floor * (before.kpa / before._floor if before else 1.0)
        self.warning: tuple[FrameWarning, ...] = ()
        self.settled: bool = self._configured is not None or (
            before is not None and before.settled
        )  # not of rounding
        self._fixed = self._configured is not None  # by which others are judged
        self._frames: list[Floats32] = []
        self._pause = 0  # frames until frames are taken again

    def settle(self, kpa: float) -> None:
        """Take what was measured before the first frame; not where it is configured."""
        if self._configured is None:
            self.kpa, self.settled, self._fixed = kpa, True, True

    def add(self, raw: Floats32) -> None:
        """Take one more frame."""
        if self._pause:
            self._pause -= 1
            return
        has_value = readings.look(raw.reshape(-1))[2] > 0
        self._frames += [raw] if has_value else []
        if len(self._frames) == NOISE_FRAMES:
            self._compare(max(self._floor, estimate(np.stack(self._frames))))
            self._frames, self._pause = [], NOISE_PAUSE_FRAMES
        elif not self.settled:
            self.warning = (warning("noise_unknown"),) if has_value else ()

    def _compare(self, measured: float) -> None:
        if not self._fixed:
            self.settle(measured)
        self.warning = ()
        if measured > NOISE_RATIO * self.kpa:
            source = "configured" if self._configured else "measured at the start"
            raised = warning("noise_high", measured=measured, noise=self.kpa, unit=self._unit, source=source)
            self.warning = (raised,)


def numbers_with_data(recorded: Iterable[RawFrame]) -> tuple[int, ...]:
    """Numbers of the frames from which a recording's noise is measured: its first ones with data."""
    searched = enumerate(islice(recorded, MAX_NOISE_SEARCH))
    return tuple(islice((n for n, each in searched if _has_data(each)), NOISE_FRAMES))


def _has_data(frame: RawFrame) -> bool:
    return bool((frame.flags & UNKNOWN == 0).any())


def recorded_noise(plan: SensorPlan, with_data: Iterable[RawFrame], zero: Floats32 | None = None) -> float:
    """Standard deviation of a taxel, in the unit of `plan`: as configured, else of a recording's first frames.

    These are those with data; `zero` is a tare's counts.
    """
    if plan.calibration.noise_kpa:
        return plan.calibration.noise_kpa
    if not (first := list(with_data)):
        return plan.calibration.floor_kpa
    calibrator = Calibrator(plan.calibration, plan.array.size)
    if zero is not None:
        calibrator.tare(zero.astype(float))
    raw, _ = calibrator.series(np.stack([each.counts for each in first]), np.stack([each.flags for each in first]))
    return max(plan.calibration.floor_kpa, estimate(raw.reshape(-1, *plan.array.frame_shape)))


def measure_noise(
    recording: "Recording", codecs: Mapping[str, Codec], plans: Iterable[SensorPlan]
) -> dict[str, float]:
    """Noise of the sensors that have frames in a recording, before it is restored, by their names.

    What is wrong with the recording, or in a codec, whoever restores it meets, too.
    """
    from tactiled.bus.replay import frames  # and python-can, which a service without a bus does not need

    sought = {plan.name: plan for plan in plans if not plan.calibration.noise_kpa}
    firsts: dict[str, list[RawFrame]] = {name: [] for name in sought}
    open_ = dict.fromkeys(sought, MAX_NOISE_SEARCH)  # frames to be searched yet
    with suppress(Exception):
        messages = islice(recording, MAX_SEARCHED_MESSAGES) if sought else ()
        for name, frame in frames(messages, Router(codecs)):
            if name in open_:
                firsts[name] += [frame] if _has_data(frame) else []
                open_[name] -= 1
                if len(firsts[name]) == NOISE_FRAMES or not open_[name]:
                    del open_[name]
                if not open_:
                    break
    return {name: recorded_noise(sought[name], each) for name, each in firsts.items() if each}
