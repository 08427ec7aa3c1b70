"""How fast a recording is played: as its messages were, but for steps of its clock; pure."""

PAUSE_S = 10.0  # longest pause that is played: a longer one is a step of the clock, or nobody waits for its end
BACK_S = 1.0  # more than messages of several buses are out of order by; so much is played of a step back


class Pace:
    """Time (s) since a recording's first message, which goes on with its messages and never back.

    Of a step, a pause longer than PAUSE_S or one back by more than BACK_S, so much is played and no more.
    """

    def __init__(self) -> None:
        self.now = 0.0  # s, of the newest message
        self.steps = self._count = 0
        self._origin: float | None = None  # s, the recording's time at 0

    def go(self, time: float) -> str | None:
        """Go on to the next message, of `time` (s); returns what to tell of a step, None where there is none."""
        self._count += 1
        self._origin = time if self._origin is None else self._origin
        ahead = time - self._origin - self.now
        if -BACK_S <= ahead <= PAUSE_S:
            self.now = max(self.now, time - self._origin)
            return None
        played = PAUSE_S if ahead > 0 else BACK_S
        self._origin += ahead - played
        self.now += played
        self.steps += 1
        what = f"pauses for {ahead:.6g} s before" if ahead > 0 else f"steps back in time by {-ahead:.6g} s at"
        return f"{what} message {self._count}"
