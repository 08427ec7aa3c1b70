"""A recording in the place of a bus: the same frames from run to run, at any speed."""

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from threading import TIMEOUT_MAX, Event, Thread

import numpy as np

from tactiled.bus.assembler import SILENCE_S
from tactiled.bus.batch import Batch
from tactiled.bus.codec import Codec
from tactiled.bus.recording import Pace, Recording
from tactiled.bus.router import Router
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Message, RawFrame
from tactiled.threads import join_started

AT_ONCE = 1024  # messages decoded at once; more save no time
LOG = logging.getLogger(__name__)


def frames(messages: Iterable[Message], router: Router, at_once: int = 1) -> Iterator[tuple[str, RawFrame]]:
    """Every (sensor, frame) of a recording; its own times, not the clock's, close half-received frames.

    A whole frame comes with its last message; with more messages `at_once` up to so many later. A fault in the
    recording is raised behind the frames before it.
    """
    pace, waiting, times, faults = Pace(), list[Message](), list[float](), list[TactileError]()
    for message in _before_fault(messages, faults):
        last, _ = pace.now, pace.go(message.time)
        if pace.now - last > SILENCE_S:
            yield from router.push(Batch.of(waiting), np.array(times))
            yield from router.flush(pace.now - SILENCE_S)
            waiting, times = [], []
        waiting.append(message)
        times.append(pace.now)
        if len(waiting) >= max(router.needed, at_once):
            yield from router.push(Batch.of(waiting), np.array(times))
            waiting, times = [], []
    yield from router.push(Batch.of(waiting), np.array(times))
    yield from router.flush(float("inf"))
    if faults:
        raise faults[0]


def _before_fault(messages: Iterable[Message], faults: list[TactileError]) -> Iterator[Message]:
    """The messages before a fault in their recording, which is added to `faults`."""
    try:
        yield from messages
    except TactileError as error:
        faults.append(error)


class Replay:
    """A recording on a thread of its own, in the place of a bus's listener.

    `take` gets every frame and may take its time: what is behind waits, and nothing is skipped. `ended` gets one
    line at the end, and whether that is a fault, `stepped` one for each step of the recording's clock. A `speed`
    of 0 is as fast as `take` allows.
    """

    def __init__(
        self,
        path: Path,
        codecs: Mapping[str, Codec],
        take: Callable[[str, RawFrame], None],
        speed: float = 1.0,
        ended: Callable[[str, bool], None] = lambda *_: None,
        stepped: Callable[[str], None] = lambda _: None,
    ) -> None:
        if not 0 <= speed < float("inf"):
            raise ConfigError(
                f"speed = {speed}: give 1 for the recorded pace, N for N times that, 0 for no pauses"
            )
        self._router = Router(codecs)
        self._recording = Recording(path, self._router.ids)
        self._take, self._speed, self._ended, self._stepped = take, speed, ended, stepped
        self._stop = Event()
        self._thread = Thread(target=self._run, name=f"replay {path.name}", daemon=True)

    def start(self) -> None:
        """Start to play; ConfigError where there is nothing to play."""
        if next(iter(Recording(self._recording.path)), None) is None:
            raise ConfigError(f"recording {self._recording.path}: holds no data frame: nothing to replay")
        self._thread.start()

    def stop(self) -> None:
        """Stop playing."""
        self._stop.set()
        self._recording.cancel()
        join_started(self._thread)

    def _run(self) -> None:
        try:
            for name, frame in frames(self._paced(), self._router):
                if self._stop.is_set():
                    return
                self._take(name, frame)
            if not self._stop.is_set():
                self._ended(f"{self._recording.path.name} has ended after {self._recording.summary()}", False)
        except TactileError as error:
            if not self._stop.is_set():
                self._ended(str(error), True)
        except Exception as error:  # our own fault, or a codec's: no reason to go silent
            name, count = self._recording.path.name, self._recording.count
            LOG.exception("replay of %s failed", name)
            self._ended(f"{name}: the replay failed at message {count}: {type(error).__name__}: {error}", True)

    def _paced(self) -> Iterator[Message]:
        """The messages, each when it is due."""
        began, pace = time.monotonic(), self._recording.pace
        for message in self._recording:
            due = began + pace.now / self._speed if self._speed else began
            wait = min(max(0.0, due - time.monotonic()), TIMEOUT_MAX)
            if self._recording.step:
                self._stepped(f"{self._recording.path.name} {self._recording.step}: it goes on in {wait:.3g} s")
            if self._stop.wait(wait):
                return
            yield message
