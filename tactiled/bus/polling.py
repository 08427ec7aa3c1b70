"""What is sent to skins that send nothing by themselves, and when; time is an argument."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from tactiled.errors import BusError
from tactiled.frames import Message

Send = Callable[[Message], None]
START_AGAIN_S = 1.0  # until a skin is started again, whose start the bus did not take


class Poll(NamedTuple):
    """A request that is sent over and over."""

    message: Message
    period_s: float
    segments: range  # that answer it
    after_s: float = 0.0  # later than the first request: for a skin that takes one at a time


class Polling(NamedTuple):
    """What has to be sent to a skin so that it sends."""

    start: tuple[tuple[float, Message], ...] = ()  # once, each so many s after the bus was opened
    polls: tuple[Poll, ...] = ()  # over and over from then on
    stop: tuple[Message, ...] = ()  # once, before the bus is closed


class Poller:
    """The start messages, the requests and the stop messages of the skins on one bus."""

    def __init__(self, skins: Iterable[Polling]) -> None:
        skins = tuple(skins)
        self._starts = tuple(dict.fromkeys(each for skin in skins for each in skin.start))
        self._polls = tuple(each for skin in skins for each in skin.polls)
        self._stops = tuple(dict.fromkeys(each for skin in skins for each in skin.stop))
        self._starting: list[tuple[float, Message]] = []  # when (s), what
        self._due: list[float] = []  # s, of each request

    def start(self, now: float) -> None:
        """Begin with the start messages: the bus is open at `now` (s)."""
        self._starting = sorted(((now + after, each) for after, each in self._starts), key=lambda each: each[0])
        last = self._starting[-1][0] if self._starting else now
        self._due = [last + each.after_s for each in self._polls]

    def wait_s(self, now: float) -> float:
        """Seconds from `now` until something is due; inf where nothing ever is."""
        due = (*self._due, *(at for at, _ in self._starting))
        return max(0.0, min(due, default=float("inf")) - now)

    def send_due(self, send: Send, now: float) -> int:
        """Send what is due at `now` (s); returns how many messages the bus did not take (BusError)."""
        starts = [each for at, each in self._starting if at <= now]
        self._starting = self._starting[len(starts) :]
        failed = _send_all(send, starts)
        unsent = failed + _send_all(send, self._due_polls(now))
        if failed:
            self.start(now + START_AGAIN_S)
        return unsent

    def exchanged(self, skins: Iterable[Polling], send: Send, now: float) -> "Poller":
        """The poller of other skins from `now` (s) on: those gone are stopped, new ones started, others go on."""
        other, due = Poller(skins), dict(zip(self._polls, self._due, strict=True))
        _send_all(send, [each for each in self._stops if each not in other._stops])
        starts = [(now + after, each) for after, each in other._starts if (after, each) not in self._starts]
        starts += [(at, each) for at, each in self._starting if each in [message for _, message in other._starts]]
        other._starting = sorted(starts, key=lambda each: each[0])
        last = other._starting[-1][0] if other._starting else now
        other._due = [due.get(each, last + each.after_s) for each in other._polls]
        return other

    def stop(self, send: Send) -> None:
        """Send the stop messages."""
        _send_all(send, self._stops)

    def _due_polls(self, now: float) -> list[Message]:
        """Requests that are due; one that is late by more than its period moves the next, so that none burst."""
        due = []
        for at, poll in enumerate(self._polls):
            if self._due[at] <= now:
                due.append(poll.message)
                after = self._due[at] + poll.period_s
                self._due[at] = after if after > now else now + poll.period_s + poll.after_s
        return due


def _send_all(send: Send, messages: Iterable[Message]) -> int:
    failed = 0
    for each in messages:
        try:
            send(each)
        except BusError:
            failed += 1
    return failed
