"""What skins that send nothing by themselves have to be told, when it is due; time is an argument."""

from collections.abc import Callable, Iterable

from tactiled.bus.codecs import Talk
from tactiled.errors import BusError
from tactiled.frames import Message

AGAIN_S = 1.0  # until a skin is started again, whose start the bus did not take


class Talker:
    """The start messages, the requests and the stop messages of the skins on one bus."""

    def __init__(self, talks: Iterable[Talk]) -> None:
        talks = tuple(talks)
        self._starts = tuple(dict.fromkeys(each for talk in talks for each in talk.start))
        self._polls = tuple(each for talk in talks for each in talk.polls)
        self._stops = tuple(dict.fromkeys(each for talk in talks for each in talk.stop))
        self._starting: list[tuple[float, Message]] = []  # when (s), what
        self._due: list[float] = []  # s, of each request

    def begin(self, now: float) -> None:
        """The bus is open at `now` (s): start the skins, then ask."""
        self._starting = sorted(((now + after, each) for after, each in self._starts), key=lambda each: each[0])
        last = self._starting[-1][0] if self._starting else now
        self._due = [last] * len(self._polls)

    def wait(self, now: float) -> float:
        """Seconds from `now` until something is due; inf where nothing ever is."""
        due = (*self._due, *(at for at, _ in self._starting))
        return max(0.0, min(due, default=float("inf")) - now)

    def say(self, send: Callable[[Message], None], now: float) -> int:
        """Send what is due at `now` (s); returns how many messages the bus did not take (BusError)."""
        begun = [each for at, each in self._starting if at <= now]
        self._starting = self._starting[len(begun) :]
        unstarted = _unsent(send, begun)
        unsent = unstarted + _unsent(send, self._asked(now))
        if unstarted:
            self.begin(now + AGAIN_S)
        return unsent

    def end(self, send: Callable[[Message], None]) -> int:
        """Stop the skins that were started; returns how many messages the bus did not take."""
        return _unsent(send, self._stops)

    def _asked(self, now: float) -> list[Message]:
        """Requests that are due; one that is late by more than its period moves the next, so that none burst."""
        asked = []
        for at, (due, poll) in enumerate(zip(self._due, self._polls, strict=True)):
            if due <= now:
                asked.append(poll.message)
                self._due[at] = due + poll.period_s if due + poll.period_s > now else now + poll.period_s
        return asked


def _unsent(send: Callable[[Message], None], messages: Iterable[Message]) -> int:
    failed = 0
    for each in messages:
        try:
            send(each)
        except BusError:
            failed += 1
    return failed
