"""Recordings of CAN traffic, in any format that python-can reads."""

import struct
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from threading import Event
from zoneinfo import ZoneInfo

from tactiled.bus.batch import MAX_BYTES, Key
from tactiled.bus.bounded_process import BoundedProcess, Bounds, Exceeded
from tactiled.bus.canbus import CanMessage
from tactiled.bus.logfile import is_streamed, open_log
from tactiled.bus.textlog import (
    ERROR_FRAME,
    LOCAL_TIME,
    MAX_CLASSIC_BYTES,
    REMOTE_FRAME,
    UNREADABLE,
    FormatError,
    Logged,
    Remarks,
)
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Message

MAX_ID = (1 << 29) - 1
MAX_TIME_S = 1 << 32  # Unix time in 2106: no message is younger, and Foxglove's times go no further
MAX_PAUSE_S = 10.0  # longest pause that is played; a longer one is shortened
MAX_BACK_S = 1.0  # messages of several buses are less out of order; a step further back counts as this
END_CUT = "its end is cut off"
FD_LOST = "its format does not tell CAN FD: all messages of an id that has longer ones than 8 bytes count as such"
MAX_MESSAGES, MAX_MESSAGES_PER_BYTE = 1000, 4  # in a file; gzip needs 2.5 bytes for a message like the one before
CPU_S, BYTES_PER_CPU_S = 2.0, 10e6  # without a message; read in the slowest format on the slowest machine
MAX_REASON_CHARACTERS = 300  # of a reader, which may quote a whole line
LIBRARY_CPU_S = 20.0  # in place of CPU_S where a library is loaded, which reads the whole file into memory
MEMORY_MB, MEMORY_PER_BYTE = 512.0, 8  # MEMORY_PER_BYTE only with such a library
SHIPPED = Path(__file__).parents[1] / "recordings"


def names() -> tuple[str, ...]:
    """The recordings that come with the package."""
    return tuple(sorted(each.stem for each in SHIPPED.glob("*/*.log")))


def path(name: str) -> Path:
    """Where a recording of the package is; ConfigError names those that exist."""
    if name not in names():
        raise ConfigError(f"recording {name!r}: no such recording: choose one of {', '.join(names())}")
    (file,) = SHIPPED.glob(f"*/{name}.log")
    return file


class Pace:
    """Time (s) since a recording's first message; it follows the messages and never steps back.

    A pause longer than MAX_PAUSE_S lasts MAX_PAUSE_S; a step back by more than MAX_BACK_S counts as MAX_BACK_S.
    """

    def __init__(self) -> None:
        self.now = 0.0  # s, of the newest message
        self.steps = self._count = 0
        self._origin: float | None = None  # s, the recording's time at 0

    def go(self, time: float) -> str | None:
        """Go on to the next message, of `time` (s); returns a description of a step of the clock, or None."""
        self._count += 1
        self._origin = time if self._origin is None else self._origin
        ahead = time - self._origin - self.now
        if -MAX_BACK_S <= ahead <= MAX_PAUSE_S:
            self.now = max(self.now, time - self._origin)
            return None
        played = MAX_PAUSE_S if ahead > 0 else MAX_BACK_S
        self._origin += ahead - played
        self.now += played
        self.steps += 1
        step = f"pauses for {ahead:.6g} s before" if ahead > 0 else f"steps back in time by {-ahead:.6g} s at"
        return f"{step} message {self._count}"


def read(path: Path, ids: frozenset[Key] = frozenset(), remarks: Remarks | None = None) -> Iterator[Message]:
    """Every data frame of a recording, with its time; ConfigError where the file cannot be read.

    Also where messages of one of `ids`, which sensors listen to, come from two channels: frames would mix. What
    else the file has is added to `remarks`. A `Recording` does this in a process with bounds.
    """
    count, channels = 0, dict[Key, str]()
    remarks = remarks or Remarks()
    with_kind = _WithKind(remarks)
    try:
        with open_log(path, remarks) as log:
            for each in _bounded(log, MAX_MESSAGES + MAX_MESSAGES_PER_BYTE * path.stat().st_size):
                stamp = each[1].time if isinstance(each, tuple) else each.timestamp
                if not 0 <= stamp < MAX_TIME_S:
                    raise ValueError(f"time {stamp:g} s is outside 1970 to 2106")
                count += 1
                channel, message = each if isinstance(each, tuple) else with_kind(each)
                if kind := _kind(each, message):
                    remarks.left_out[kind] += 1
                    continue
                key = message.id, message.extended
                if key in ids and (first := channels.setdefault(key, channel)) != channel:
                    raise ConfigError(f"recording {path}: message {count}: {_mixed(path, key, first, channel)}")
                yield message
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"recording {path}: {error.strerror or error}: give the path of a recording") from error
    except MemoryError as error:
        raise TactileError(f"recording {path}: it needs too much memory, after {count} messages") from error
    except Exception as error:  # readers raise what they like, AssertionError and struct.error included
        reason = " ".join(str(error).split())[:MAX_REASON_CHARACTERS] or type(error).__name__
        where = f"message {count + 1}: " if count else ""
        advice = "" if isinstance(error, FormatError) else ": give a recording in a format that python-can reads"
        raise ConfigError(f"recording {path}: {where}{reason}{advice}") from error


def _bounded(log: Iterable[Logged], max_count: int) -> Iterator[Logged]:
    """What a log has; ValueError for more than `max_count` messages."""
    items = iter(log)
    yield from islice(items, max_count)
    if next(items, None) is not None:
        raise ValueError(f"more than {max_count} messages cannot be in so small a file")


def _mixed(path: Path, key: Key, first: str, second: str) -> str:
    """A line that says that an id comes from two channels, and how to keep one of them."""
    advice = "record one bus alone"
    if ".log" in path.suffixes:
        grep = "zgrep" if path.suffix == ".gz" else "grep"
        advice = f"keep one ({grep} ' {first} ' {path.name} > {first}.log)"
    elif first.isdigit() and second.isdigit():
        first, second = f"channel {first}", f"channel {second}"
    return f"id {key[0]:#x} comes from {first} and from {second}, and their frames would mix: {advice}"


def _kind(each: Logged, message: Message) -> str:
    """The kind, as Remarks counts it, of a message that is no data frame; else ""."""
    if isinstance(each, CanMessage) and (each.is_error_frame or each.is_remote_frame):
        return ERROR_FRAME if each.is_error_frame else REMOTE_FRAME
    return UNREADABLE * (not 0 <= message.id <= MAX_ID or len(message.data) > MAX_BYTES)


class _WithKind:
    """Messages of python-can's readers; without a mark of CAN FD, a long message marks all of its id."""

    def __init__(self, remarks: Remarks) -> None:
        self._remarks, self._long = remarks, set[Key]()

    def __call__(self, message: CanMessage) -> tuple[str, Message]:
        """A message and its channel."""
        data, key = bytes(message.data), (message.arbitration_id, message.is_extended_id)
        if len(data) > MAX_CLASSIC_BYTES and not (message.is_fd or key in self._long):
            self._long.add(key)
            if FD_LOST not in self._remarks.caveats:
                self._remarks.caveats.append(FD_LOST)
        fd = message.is_fd or key in self._long
        return str(message.channel), Message(message.timestamp, key[0], data, key[1], fd)


def _rows(path: Path, ids: frozenset[Key], zone: str | None) -> Iterator[tuple[object, ...]]:
    """The fields of every message; then those of the remarks, also if an error follows."""
    remarks = Remarks()
    try:
        messages = read(path, ids, remarks)
        yield from _in_zone(messages, zone, remarks) if zone else map(tuple, messages)
    except Exception:
        yield dict(remarks.left_out), remarks.caveats
        raise
    yield dict(remarks.left_out), remarks.caveats


def _in_zone(messages: Iterator[Message], zone: str, remarks: Remarks) -> Iterator[tuple[object, ...]]:
    """Fields of messages; the times of a recording that names no time zone are taken for those of `zone`."""
    ahead_s = 0.0
    for count, (time_s, *fields) in enumerate(messages):
        if count == 0 and LOCAL_TIME in remarks.caveats:
            remarks.caveats[remarks.caveats.index(LOCAL_TIME)] = f"its times were of {zone}"
            ahead_s = _ahead_s(zone, time_s)
        yield (time_s - ahead_s, *fields)


def _ahead_s(zone: str, time_s: float) -> float:
    """How far a zone's clock is ahead of UTC (s) when it shows a time (s)."""
    ahead = datetime.fromtimestamp(time_s, UTC).replace(tzinfo=ZoneInfo(zone)).utcoffset()
    return ahead.total_seconds() if ahead else 0.0


_as_message: Callable[[object], Message] = partial(tuple.__new__, Message)  # half as long as Message._make


def _bounds(path: Path) -> Bounds:
    """What reading a file may take."""
    size = path.stat().st_size if path.is_file() else 0
    cpu_s, memory_mb = CPU_S, MEMORY_MB
    if not is_streamed(path):
        cpu_s, memory_mb = LIBRARY_CPU_S, MEMORY_MB + MEMORY_PER_BYTE * size / 1e6
    return Bounds(cpu_s + size / BYTES_PER_CPU_S, memory_mb)


class Recording:
    """The data frames of a recording, once through; an end that a crash cut off is left out and reported.

    A process with bounds reads it: whatever the file has, it comes to an end. Any thread may `cancel`.
    """

    def __init__(self, path: Path, ids: frozenset[Key] = frozenset(), zone: str | None = None) -> None:
        """`ids` are those that sensors listen to; `zone` is where it was made, if it does not say so itself."""
        self.path = path
        self._process = BoundedProcess(_bounds(path), _rows, path, ids, zone)
        self.cancel = self._process.cancel
        self.count = 0  # messages so far
        self.torn = False  # whether the end turned out to be cut off
        self.remarks = Remarks()  # what else it has so far
        self.pace = Pace()  # as of the newest message
        self.step: str | None = None  # a description of a step of the clock right before it

    def __iter__(self) -> Iterator[Message]:
        """Every whole message; ConfigError where the recording cannot be read or meant, or was cancelled."""
        try:
            for row in self._process:
                if len(row) < len(Message._fields):
                    self.remarks = Remarks(Counter(row[0]), row[1])
                    continue
                message = _as_message(row)
                self.count += 1
                self.step = self.pace.go(message.time)
                yield message
        except ConfigError as error:
            if not isinstance(error.__cause__, EOFError | struct.error):
                raise
            self.torn = True
        except Exceeded as error:
            raise ConfigError(f"recording {self.path}: after {self.count} messages {error}") from error

    def summary(self) -> str:
        """One phrase of what was read, and of what was not."""
        count = self.pace.steps
        steps = f", with {count} step{'s' if count > 1 else ''} of their clock" if count else ""
        also = "; ".join([*self.caveats(), *[END_CUT] * self.torn])
        return f"{self.count} messages{steps}" + (f" ({also})" if also else "")

    def caveats(self) -> list[str]:
        """What was left out, and what is in doubt; one phrase each."""
        kinds = self.remarks.left_out
        parts = [f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in sorted(kinds.items()) if count]
        left_out = [f"left out: {', '.join(parts)}"] if parts else []
        return [*left_out, *self.remarks.caveats]


def play(path: Path, send: Callable[[Message], None], stop: Event, loop: bool = False) -> int:
    """Send a recording at its own pace until its end, or in a loop until `stop`; returns how many messages.

    A message bears the time of its sending. In a loop a lap follows the one before after the recording's longest
    pause, so that a frame is not cut short. Nothing is sent of a recording that cannot be read to its end.
    """
    recording = Recording(path)
    messages = [(recording.pace.now, each) for each in recording]
    lap_s = recording.pace.now + max(
        (after - before for (before, _), (after, _) in pairwise(messages)), default=1.0
    )
    count, began = 0, time.monotonic()
    while messages and (count == 0 or loop):
        for at, message in messages:
            if stop.wait(max(0.0, began + at - time.monotonic())):
                return count
            send(message._replace(time=time.time()))
            count += 1
        began += lap_s
    return count
