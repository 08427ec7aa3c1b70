"""Checks the map of taxels while an array is in use, from loads that move over it."""

import numpy as np

from tactiled.arrays import Floats32
from tactiled.calibrate.upkeep.taxel_map import MapVerdict, check_map
from tactiled.geometry import Array

PERIOD_S = 0.1  # from one look at the load to the next, at least
CHANGE = 0.2  # of the load's square since the last frame taken: with more the load has moved
CLEAR_SIGMAS = 10.0  # noise standard deviations of a load
WINDOW_FRAMES, NEW_FRAMES = 256, 64  # of a verdict, and how many of these must be new since the last one
# With all three, one of 220 healthy runs of 4 min of all scenes, t/pitch 0.5 to 3, 4 x 4 to 12 x 6, had a false
# alarm; with seams of 0.1, 7 of 176.
MIN_PRESSED = 0.5  # of the taxels: less, and a scene's own symmetry may look like a wrong map
SWAPPED = 0.55  # of two taxels' own roughness: they are swapped
ROUGH_SEAMS = 0.7  # of blocks that may be wrong: under a load that comes back to few places less says nothing


class MapMonitor:
    """What two windows of frames in a row find wrong with the map of an array."""

    def __init__(self, array: Array) -> None:
        self._array = array
        self._frames: list[Floats32] = []  # (N,) each, counts over zero
        self._sigma: Floats32 = np.zeros(array.size, np.float32)
        self._looked_at = -np.inf
        self._before = MapVerdict(())
        self.judged = False
        self.wrong: tuple[str, ...] = ()  # for people
        self.swapped = np.zeros(array.size, bool)

    def due(self, time_s: float) -> bool:
        """Whether the load is worth a look."""
        return not 0 <= time_s - self._looked_at < PERIOD_S

    def observe(self, time_s: float, load: Floats32, sigma: Floats32) -> None:
        """Take a load and its noise, (N,) counts, 0 where unknown; only one that has moved is kept."""
        self._looked_at, frames = time_s, self._frames
        if len(frames) >= WINDOW_FRAMES or not (load > CLEAR_SIGMAS * sigma).any():
            return
        last = frames[-1] if frames else np.zeros_like(load)
        change, strength = load - last, max(float(load @ load), float(last @ last))
        if float(change @ change) > 2 * float(sigma @ sigma) + CHANGE * strength:
            frames.append(load)
            self._sigma = sigma

    def judge(self) -> None:
        """Judge the map once there are enough frames; any one thread, while another pushes."""
        if len(self._frames) < WINDOW_FRAMES:
            return
        frames = np.stack(self._frames)
        verdict = check_map(
            frames, self._array, self._sigma, min_pressed=MIN_PRESSED, swapped=SWAPPED, rough_seams=ROUGH_SEAMS
        )
        if verdict.order is None:  # more places are needed: keep every other frame
            self._frames = self._frames[::2]
            return
        either = {*verdict.texts, *self._before.texts}
        both = {*verdict.texts} & {*self._before.texts}
        self.wrong = tuple(sorted(text for text in either if text in both or text in self.wrong))
        self.swapped = np.zeros(self._array.size, bool)
        for pair in {*verdict.swaps, *self._before.swaps}:
            if f"taxels {pair[0]} and {pair[1]} swapped" in self.wrong:
                self.swapped[list(pair)] = True
        self._before, self._frames, self.judged = verdict, self._frames[NEW_FRAMES:], True
