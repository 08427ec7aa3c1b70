"""Processor time for restoring a frame: how much there is where none is configured, and when it is over."""

from time import thread_time

MAX_BUDGET_S = 1e-3
SHARE = 0.1  # of the time from frame to frame
MAX_SHARES = 0.4  # of all sensors of a service together


def budget_share(sensors: int) -> float:
    """Share of its time from frame to frame that each of so many sensors may restore; all do not fill a core."""
    return min(SHARE, MAX_SHARES / sensors)


def default_budget_s(period_s: float, share: float) -> float:
    """The budget of a sensor with this time from frame to frame (s; 0: unknown) and share of it."""
    return min(share * period_s, MAX_BUDGET_S) if period_s else MAX_BUDGET_S


class Deadline:
    """Whether a thread's processor time for an image is over.

    It is so before a step that would end too late if it took as long as the one before.
    """

    def __init__(self, budget_s: float) -> None:
        self._last = thread_time()
        self._end = self._last + budget_s

    def __call__(self) -> bool:
        """Whether to stop now; asked before every step."""
        now = thread_time()
        step, self._last = now - self._last, now
        return now + step > self._end
