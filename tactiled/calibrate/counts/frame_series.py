"""Frames of one array in counts, as a calibration takes them: out of a recording, or collected live."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tactiled.arrays import Floats, Floats32


@dataclass(frozen=True, slots=True, eq=False)
class FrameSeries:
    """Frames in the order of their times."""

    times: Floats  # (T,) s, of each frame's first message
    counts: Floats32  # (T, N); NaN where a taxel is unknown

    def without(self, taxels: Sequence[int]) -> Self:
        """The same where nothing is known of some taxels."""
        counts = self.counts.copy()
        counts[:, list(taxels)] = np.nan
        return replace(self, counts=counts)
