"""Which cover would explain a frame that the configured one does not: searched once a mismatch."""

from collections.abc import Callable

import numpy as np

from tactiled.arrays import Flags, Floats32
from tactiled.build import SensorPlan
from tactiled.cover.family import CoverFamily
from tactiled.diagnostics.cover_thickness import fitting_thickness
from tactiled.diagnostics.warning_codes import WarningCode, cover_warning
from tactiled.frames import FrameWarning

SUSPECTS: set[WarningCode] = {"cover_mismatch", "outliers"}  # what too thick a cover's model may look like
PAUSE_FRAMES = 1000  # between two searches: each takes 0.2 to 0.5 s of a core
Start = Callable[[Callable[[], None]], object]  # runs a search, at once or on a thread


class ThicknessSearch:
    """Holds suspicions of one array back until a search has ended, then names the thickness that explains them."""

    def __init__(self, plan: SensorPlan, start: Start) -> None:
        self._plan, self._start = plan, start
        self._searchable = plan.array.shape is not None and plan.kernel.model != "measured"
        self._thickness_mm: float | None = None
        self._mismatched, self._searching, self._pause = False, False, 0

    def __call__(
        self,
        warnings: tuple[FrameWarning, ...],
        raw: Floats32,
        flags: Flags,
        noise_kpa: float,
    ) -> tuple[FrameWarning, ...]:
        """The warnings of a frame: what a thinner cover explains is `cover_mismatch`, with that thickness."""
        self._pause = max(self._pause - 1, 0)
        mismatched = self._searchable and any(each.code in SUSPECTS for each in warnings)
        if mismatched and not (self._mismatched or self._searching or self._pause):
            self._search(np.where(flags == 0, raw, np.nan), noise_kpa)
        self._mismatched = mismatched
        if not mismatched:
            return warnings
        others = tuple(each for each in warnings if each.code not in SUSPECTS)
        if self._searching:
            return others
        if self._thickness_mm is None:
            return warnings
        return (*others, cover_warning(self._thickness_mm, self._plan.kernel.stack.depth))

    def _search(self, frame: Floats32, noise_kpa: float) -> None:
        self._thickness_mm, self._searching, self._pause = None, True, PAUSE_FRAMES

        def search() -> None:
            try:
                family = CoverFamily(self._plan.kernel.stack)
                self._thickness_mm = fitting_thickness(frame, noise_kpa, family, self._plan.array)
            finally:
                self._searching = False

        self._start(search)
