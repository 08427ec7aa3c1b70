"""The noise of a sensor's taxels in a recording, and its shear at rest, measured before its first image."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.build import SensorPlan
from tactiled.bus.codec import Codec
from tactiled.bus.router import Router
from tactiled.calibrate.counts.calibration import Calibrator
from tactiled.calibrate.counts.tare import load_description, robust_mean
from tactiled.frames import UNKNOWN, RawFrame
from tactiled.live.noise import NOISE_FRAMES
from tactiled.restore.noise import estimate_with_rounding

if TYPE_CHECKING:
    from tactiled.bus.recording import Recording

MAX_NOISE_SEARCH = 1000  # frames of a recording from which those with data are taken
MAX_SEARCHED_MESSAGES = 1_000_000  # of a recording, which may have no frame


def numbers_with_data(recorded: Iterable[RawFrame]) -> tuple[int, ...]:
    """Numbers of the frames from which a recording's noise is measured: its first ones with data."""
    searched = enumerate(islice(recorded, MAX_NOISE_SEARCH))
    return tuple(islice((n for n, each in searched if _has_data(each)), NOISE_FRAMES))


def are_all(numbers: Sequence[int], count: int) -> bool:
    """Whether these `numbers_with_data` of the first `count` frames are complete."""
    return len(numbers) == NOISE_FRAMES or count >= MAX_NOISE_SEARCH


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
    frames = raw.reshape(-1, *plan.array.frame_shape)
    return estimate_with_rounding(frames, plan.calibration.floor_kpa, plan.codec.rounds)


def measure(
    recording: "Recording", codecs: Mapping[str, Codec], plans: Iterable[SensorPlan]
) -> dict[str, tuple[float | None, Floats | None]]:
    """Noise and `shear_rest` of the sensors that have frames in a recording, by name, before it is restored.

    Each is None where it is configured, or not known. Errors of the recording or a codec are passed over here:
    whoever restores it meets them again.
    """
    from tactiled.bus.replay import frames  # and python-can, which a service without a bus does not need

    sought = {each.name: each for each in plans if each.restores_shear or not each.calibration.noise_kpa}
    firsts: dict[str, list[RawFrame]] = {name: [] for name in sought}
    open_ = dict.fromkeys(sought, MAX_NOISE_SEARCH)  # frames that are still to be searched
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
    found = {name: (sought[name], each) for name, each in firsts.items() if each}
    return {
        name: (None if plan.calibration.noise_kpa else recorded_noise(plan, each), shear_rest(plan, each))
        for name, (plan, each) in found.items()
    }


def shear_rest(plan: SensorPlan, first: Sequence[RawFrame]) -> Floats | None:
    """Mean shear (2, N) of a recording's first frames, in counts; None where a load lies on."""
    shears = [each.shear for each in first if each.shear is not None]
    if not (plan.restores_shear and shears):
        return None
    calibrator = Calibrator(plan.calibration, plan.array.size)
    raw, _ = calibrator.series(np.stack([each.counts for each in first]), np.stack([each.flags for each in first]))
    noise = plan.calibration.noise_kpa or recorded_noise(plan, first)
    return None if load_description(tuple(raw), noise, plan.unit) else robust_mean(np.stack(shears))
