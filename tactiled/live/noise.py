"""The noise of a live sensor's taxels, from its first frames on."""

import numpy as np

from tactiled.arrays import Floats32
from tactiled.calibrate.counts.calibration import Calibration
from tactiled.core import readings
from tactiled.diagnostics.checks import NOISE_RATIO
from tactiled.diagnostics.warning_codes import warning
from tactiled.frames import FrameWarning
from tactiled.restore.noise import estimate_with_rounding
from tactiled.units import Unit

NOISE_FRAMES = 32  # from which the noise is measured, to 3 % on 64 taxels
NOISE_PAUSE_FRAMES = 992  # until it is measured again: every 10 s at 100 Hz


class Noise:
    """Standard deviation of a taxel, in `unit`: as configured, else of the first frames; measured now and then."""

    def __init__(
        self, calibration: Calibration, unit: Unit, before: "Noise | None" = None, rounds: bool = True
    ) -> None:
        """`before` is of the same array with another gain: its noise in counts is the start.

        `rounds`: all readings are whole counts; else those that differ by whole counts are.
        """
        self._unit, self._rounds = unit, rounds
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

    def learn(self, raw: Floats32) -> None:
        """Take one more frame."""
        if self._pause:
            self._pause -= 1
            return
        has_value = readings.look(raw.reshape(-1))[2] > 0
        self._frames += [raw] if has_value else []
        if len(self._frames) == NOISE_FRAMES:
            self._compare(estimate_with_rounding(np.stack(self._frames), self._floor, self._rounds))
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
