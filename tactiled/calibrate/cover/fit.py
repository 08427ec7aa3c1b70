"""What presses say of a cover: its thickness over the configured one, with its interval and its reasons."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactiled.arrays import Floats
from tactiled.restore.noise import NORMAL_95

Method = Literal["tip", "edge", "blind"]
MIN_SIZE_MM = 0.05  # of a tip or ridge: less was most likely given in metres
MAX_TIP_MM, MAX_EDGE_MM = 100, 1000


@dataclass(frozen=True, slots=True, eq=False)
class CoverFit:
    """A fitted cover. Thickness is that of all layers over the sensing plane, which are scaled alike.

    The factor makes up for an aperture and a Poisson's ratio other than configured; `interval` holds the true one.
    """

    method: Method
    factor: float  # fitted thickness over the configured one
    interval: tuple[float, float]  # of the factor, 95 %
    thickness_mm: float
    interval_mm: tuple[float, float]  # 95 %
    presses: int  # presses, edges or frames that were used
    residual: float = np.nan  # root mean square of presses that were left out of the fit, over the noise
    reason: str = ""  # why the presses cannot tell the thickness; "" where they can
    objection: str = ""  # why the presses refuse the model, and what to do; "" where they do not
    effective: tuple[float, float] | None = None  # 95 % of the factor that restores with the sensor as configured
    notes: tuple[str, ...] = ()  # what these presses cannot tell, and what was not used
    line: Floats | None = None  # (3, n): x (mm), measured and fitted response over the peak, for the plot
    kernel: Floats | None = None  # (2, m): q (cycles/mm, 0 first) and gain of the free radial kernel

    @property
    def thickness_error(self) -> float:
        """Relative standard deviation of the thickness that restores; NORMAL_95 of them are half of 95 %."""
        low, high = self.effective or self.interval
        return (high - low) / (2 * NORMAL_95 * self.factor)
