"""A bus's raw traffic into a file: every message of it, or an error that says how many."""

import io
import os
import time
from contextlib import suppress
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from shutil import disk_usage
from threading import Event, Thread
from typing import Any, BinaryIO, cast

from tactiled.bus.canbus import CanMessage, channel2int
from tactiled.bus.logfile import WRITERS, flush
from tactiled.bus.reader import Reader
from tactiled.errors import BusError, ConfigError, TactileError

FLUSH_S = 0.25  # from one write to the disk to the next: a crash costs no more, but for what a slow disk delays
MAX_WAITING = 100_000  # messages for the disk, 6 s of two full 1 Mbit/s buses, before it counts as too slow
JITTER_S = 0.1  # by which a message may be older than the one before it without a step of the clock
READ_S = 0.05  # how long a read waits: a stop, or a drop of the kernel, is seen no later


class ChunkFile(io.RawIOBase):
    """A new file that `flush` makes longer by all that was written since, or, where that fails, by nothing."""

    _fd = -1  # of a file that could not be opened: its finalizer closes it, too

    def __init__(self, path: Path) -> None:
        self._path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self._waiting = bytearray()
        self._at = self._size = 0
        self.failed = False

    def writable(self) -> bool:
        """It is written to."""
        return True

    def seekable(self) -> bool:
        """A header is written again at the end."""
        return True

    def write(self, data: Any) -> int:
        """Take bytes for the next `flush`."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._at + len(self._waiting)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to `offset` from the start; what was written goes to the disk first."""
        if whence != os.SEEK_SET:
            raise io.UnsupportedOperation("only from the start")
        self.flush()
        self._at = offset
        return offset

    def flush(self) -> None:
        """Put on the disk what was written; OSError, and the file stays as it was, where it does not go there.

        TactileError where another program has changed the file.
        """
        data, self._waiting = memoryview(self._waiting), bytearray()
        if self.failed or self.closed:
            return
        self.check()
        try:
            at = self._at
            while data:
                written = os.pwrite(self._fd, data, at)
                at, data = at + written, data[written:]
            os.fsync(self._fd)
        except OSError:
            self.failed = True
            with suppress(OSError):
                os.ftruncate(self._fd, self._size)
            raise
        self._at, self._size = at, max(self._size, at)

    def check(self) -> None:
        """TactileError, and nothing more is written, where another program has changed it; it may be renamed."""
        own = os.fstat(self._fd)
        try:
            same = os.path.samestat(own, self._path.stat())
        except FileNotFoundError:
            same = None
        if not own.st_nlink and not same:  # some file systems count no links
            fault = "was removed"
        elif same is False:
            fault = "was replaced by another file"
        elif own.st_size != self._size:
            fault = f"was changed by another program: it has {own.st_size} bytes, {self._size} were written"
        else:
            return
        self.failed = True
        raise TactileError(fault)

    def close(self) -> None:
        """Flush, check and close."""
        if self.closed or self._fd < 0:
            return
        try:
            super().close()
            if not self.failed:
                self.check()
        finally:
            os.close(self._fd)


class Recorder:
    """A new recording and the thread that writes it.

    `put` never waits for the disk. Where the disk fails, falls behind by more than `max_waiting` messages or has
    less than `leave_mb` left, `put` and `close` raise TactileError, and the file holds all messages up to a point,
    which the error names. ConfigError for a `leave_mb` that is no bound.
    """

    def __init__(self, path: Path, max_waiting: int = MAX_WAITING, leave_mb: float = 0.0) -> None:
        if not 0 <= leave_mb < inf:
            raise ConfigError(f"recordings_leave_mb = {leave_mb:g}: give 0 (no bound) or more, in MB")
        self.path, self._max_waiting, self._leave_mb = path, max_waiting, leave_mb
        self.written = 0  # messages that are on the disk
        self._encoded = 0  # messages that the writer was given
        self._queue: SimpleQueue[CanMessage | None] = SimpleQueue()
        self._fault: str | None = None
        ending = _ending(path)
        try:
            self._check_free_space()
            self._file = ChunkFile(path)
        except FileExistsError as error:
            raise ConfigError(f"{path} is there already: name another file, or remove it first") from error
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}: name a file that can be written") from error
        except TactileError as error:
            raise TactileError(f"{path}: {error}") from error
        self._start_s = 0.0 if ending.startswith(".log") else None  # time before which the format can hold none
        self._writer = WRITERS[ending](cast(BinaryIO, self._file))
        self._thread = Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def put(self, message: CanMessage) -> None:
        """Take one message."""
        if self._queue.qsize() >= self._max_waiting:
            self._fault = self._fault or f"the disk is too slow: {self._max_waiting} messages wait for it"
        self.check()
        self._queue.put(message)

    def check(self, more: str = "") -> None:
        """TactileError where the recording has ended before its time; `more` ends its text."""
        if self._fault is not None:
            raise TactileError(f"{self.path}: {self._fault}: the recording ends early{more}")

    def close(self) -> None:
        """Write what waits and close the file; TactileError where not all of it is on the disk."""
        self._queue.put(None)
        self._thread.join()
        self.check(f", after {self.written} messages")

    def _run(self) -> None:
        try:
            self._flush()  # the header
            self._write()
            self._end()
        except Exception as error:  # a writer may raise anything for a message that its format cannot hold
            reason = error.strerror if isinstance(error, OSError) else str(error)
            self._fault = " ".join((reason or type(error).__name__).split())
            with suppress(OSError, TactileError):
                self._end()

    def _end(self) -> None:
        """Write the format's end and close the file, of which nothing more is written once the disk has failed."""
        self._writer.stop()
        self._file.close()
        if not self._file.failed:
            self.written = self._encoded

    def _write(self) -> None:
        """Write what comes until None does; flush in time."""
        due = time.monotonic() + FLUSH_S
        while True:
            with suppress(Empty):
                message = self._queue.get(timeout=max(0.0, due - time.monotonic()))
                if message is None:
                    return
                message.timestamp = self._time(message.timestamp)
                message.channel = _channel(message)
                self._writer.on_message_received(message)
                self._encoded += 1
            if time.monotonic() >= due:
                self._flush()
                due = time.monotonic() + FLUSH_S

    def _time(self, time_s: float) -> float:
        """A message's time (s), or the first one's where the format has none before it; TactileError if far."""
        if self._start_s is None:
            self._start_s = time_s
        if time_s < self._start_s - JITTER_S:
            raise TactileError(
                f"the clock was set back to {self._start_s - time_s:.3g} s before the first message, "
                "which only .log files can hold"
            )
        return max(time_s, self._start_s)

    def _flush(self) -> None:
        flush(self._writer)
        self.written = self._encoded
        self._check_free_space()

    def _check_free_space(self) -> None:
        """TactileError where there is less room than is to be left."""
        if self._leave_mb and disk_usage(self.path.parent).free < self._leave_mb * 1e6:
            raise TactileError(f"less than {self._leave_mb:g} MB of its disk are free (recordings_leave_mb)")


def _ending(path: Path) -> str:
    """The format of a file by its name; ConfigError if it is not supported."""
    ending = next((each for each in WRITERS if path.name.lower().endswith(each)), None)
    if ending is None:
        raise ConfigError(f"{path}: unsupported format; use one of {', '.join(WRITERS)}")
    if ending.count(".") > 1 and len(path.suffixes) > 2:
        raise ConfigError(f"{path}: python-can could not read it again: leave out dots before {ending}")
    return ending


def _channel(message: CanMessage) -> str | None:
    """The message's channel where every format can hold it."""
    name = "".join(str(message.channel or "").split())
    number = channel2int(name)
    return name if name and (number is None or number < 255) else None


def record(reader: Reader, recorder: Recorder, stop: Event, seconds: float = inf) -> int:
    """Record a bus until `stop` or for `seconds`, error and remote frames too; returns the messages in the file.

    TactileError, with the file readable to the point that it names, where bus or disk ends it before.
    """
    now = due = time.monotonic()
    end = now + seconds
    try:
        while not stop.is_set() and now < end:
            message = reader.frame(min(end - now, READ_S))
            if message is not None:
                recorder.put(message)
            if (now := time.monotonic()) >= due:
                recorder.check()
                _check_drops(reader)
                due = now + READ_S
        _check_drops(reader)
    except BusError as error:
        recorder.close()
        raise BusError(f"{error}: the recording ends early, after {recorder.written} messages") from error
    finally:
        recorder.close()
    return recorder.written


def _check_drops(reader: Reader) -> None:
    """BusError where the kernel has dropped messages that were not taken in time."""
    if dropped := reader.dropped:
        raise BusError(
            f"bus {reader.label}: the kernel dropped {dropped} messages: this machine is too busy for it"
        )
