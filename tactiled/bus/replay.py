"""A recording in the place of a bus: the same frames from run to run, at any speed."""

import struct
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from threading import Event, Thread

from tactiled.bus import recording
from tactiled.bus.codecs import Codec
from tactiled.bus.router import Router
from tactiled.errors import ConfigError
from tactiled.frames import Message, RawFrame

GAP_S = 0.05  # of silence after which a half-received frame is closed, as on a bus
TEXT = (".log", ".asc")  # recordings of lines


class Recording:
    """The data frames of a recording, once through; what a crash cut off at its end is left out and told."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0  # messages so far
        self.torn = False  # whether the end turned out to be cut off

    def __iter__(self) -> Iterator[Message]:
        """Every whole message; ConfigError where the recording cannot be read or meant."""
        cut, held = _cut(self.path), None
        try:
            for message in recording.read(self.path):
                if held is not None:
                    yield self._counted(held)
                held = message
        except ConfigError as error:
            if not (cut or isinstance(error.__cause__, EOFError | struct.error)):
                raise
            self.torn, cut = True, False  # the message that could not be read is the one that was cut
        self.torn |= cut
        if held is not None and not cut:
            yield self._counted(held)

    def _counted(self, message: Message) -> Message:
        self.count += 1
        return message

    def told(self) -> str:
        """One phrase of what was read."""
        return f"{self.count} messages" + (", then an end that was cut off" if self.torn else "")


def _cut(path: Path) -> bool:
    """Whether a text file's last line lacks its end."""
    if path.suffix.lower() not in TEXT or not path.is_file() or not path.stat().st_size:
        return False
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read() != b"\n"


def frames(messages: Iterable[Message], router: Router) -> Iterator[tuple[str, RawFrame]]:
    """Every (sensor, frame) of a recording; its own times, not the clock's, close half-received frames."""
    last: float | None = None
    for message in messages:
        if last is not None and message.time - last > GAP_S:
            yield from router.flush(message.time - GAP_S)
        last = message.time
        yield from router.push(message)
    yield from router.flush(float("inf"))


class Replay:
    """A recording on a thread of its own, in the place of a bus's listener.

    `take` gets every frame and may take its time: what is behind waits, and nothing is skipped. `ended` gets one
    line at the end. A `speed` of 0 is as fast as `take` allows.
    """

    def __init__(
        self,
        path: Path,
        codecs: Mapping[str, Codec],
        take: Callable[[str, RawFrame], None],
        speed: float = 1.0,
        ended: Callable[[str], None] = lambda _: None,
    ) -> None:
        if not 0 <= speed < float("inf"):
            raise ConfigError(
                f"speed = {speed}: give 1 for the recorded pace, N for N times that, 0 for no pauses"
            )
        self._recording, self._router = Recording(path), Router(codecs)
        self._take, self._speed, self._ended = take, speed, ended
        self._messages: Iterator[Message] = iter(())
        self._stop = Event()
        self._thread = Thread(target=self._run, name=f"replay {path.name}", daemon=True)

    def start(self) -> None:
        """Start to play; ConfigError where there is nothing to play."""
        messages = iter(self._recording)
        first = next(messages, None)
        if first is None:
            raise ConfigError(f"recording {self._recording.path}: holds no data frame: nothing to replay")
        self._messages = chain((first,), messages)
        self._thread.start()

    def stop(self) -> None:
        """Stop playing."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            for name, frame in frames(self._paced(), self._router):
                if self._stop.is_set():
                    return
                self._take(name, frame)
            self._ended(f"{self._recording.path.name} has ended after {self._recording.told()}")
        except ConfigError as error:
            self._ended(str(error))

    def _paced(self) -> Iterator[Message]:
        """The messages, each when it is due."""
        began, first = time.monotonic(), None
        for message in self._messages:
            first = message.time if first is None else first
            due = began + (message.time - first) / self._speed if self._speed else began
            if self._stop.wait(max(0.0, due - time.monotonic())):
                return
            yield message
