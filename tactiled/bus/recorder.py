"""A bus's raw traffic into a file: every message of it, or a loud end."""

import gzip
import io
import os
import time
from collections.abc import Callable
from contextlib import suppress
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from shutil import disk_usage
from threading import Event, Thread
from typing import Any, BinaryIO, cast

import can

from tactiled.bus.reader import Reader, open_bus
from tactiled.errors import BusError, ConfigError, TactileError

FLUSH_S = 0.25  # how often what has come is put on the disk: a crash costs no more, and a slow disk's time
WAITING = 100_000  # messages that wait for the disk, 6 s of two full 1 Mbit/s buses, before it counts as too slow
POLL_S = 0.05  # how long a read waits: bounds how late a stop, or what the kernel dropped, is seen


class Tap:
    """An open bus as a recorder hears it: error and remote frames too, nothing left out."""

    def __init__(self, reader: Reader) -> None:
        self._reader, self.label = reader, reader.label
        self.receive = reader.frame
        self.close = reader.close
        self._before = reader.dropped

    @property
    def unreadable(self) -> int:
        """Messages that the bus's interface could not decode, of which the recording has nothing."""
        return self._reader.unreadable

    def check(self) -> None:
        """BusError where the kernel has dropped messages that were not taken in time."""
        if (dropped := self._reader.dropped - self._before) > 0:
            raise BusError(
                f"bus {self.label}: the kernel dropped {dropped} messages: this machine is too busy for it"
            )


def open_tap(interface: str, **settings: Any) -> Tap:
    """Open a bus by python-can's own names to record it; BusError where it cannot be opened."""
    return Tap(open_bus(interface, **settings))


class ChunkFile(io.RawIOBase):
    """A new file that `flush` makes longer by all that was written since, or, where that fails, by nothing."""

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
        if fault := self._meddled():
            self.failed = True
            raise TactileError(fault)

    def _meddled(self) -> str | None:
        """What another program did to it."""
        here = os.fstat(self._fd)
        try:
            same = os.path.samestat(here, self._path.stat())
        except FileNotFoundError:
            same = None
        if not here.st_nlink and not same:  # some file systems count no links
            return "was removed"
        if same is False:
            return "was replaced by another file"
        if here.st_size != self._size:
            return f"was changed by another program: it has {here.st_size} bytes, {self._size} were written"
        return None

    def close(self) -> None:
        """Flush, check and close."""
        if self.closed:
            return
        try:
            super().close()
            if not self.failed:
                self.check()
        finally:
            os.close(self._fd)


def _text(file: BinaryIO) -> io.TextIOWrapper:
    return io.TextIOWrapper(file, "utf-8", newline="\n")


def _gzip(file: BinaryIO) -> BinaryIO:
    return cast(BinaryIO, gzip.GzipFile("", "wb", 6, file, 0))


WRITERS: dict[str, Callable[[BinaryIO], can.io.generic.MessageWriter]] = {
    ".log": lambda file: can.CanutilsLogWriter(_text(file), "can0"),
    ".asc": lambda file: can.ASCWriter(_text(file)),
    ".blf": can.BLFWriter,
    ".log.gz": lambda file: can.CanutilsLogWriter(_text(_gzip(file)), "can0"),
    ".asc.gz": lambda file: can.ASCWriter(_text(_gzip(file))),
}  # python-can's formats that keep all of a message and can be read without their end


def _writer(path: Path) -> Callable[[BinaryIO], can.io.generic.MessageWriter]:
    """The writer for a file's ending; ConfigError where there is none."""
    for ending, make in WRITERS.items():
        if path.name.lower().endswith(ending):
            if ending.count(".") > 1 and len(path.suffixes) > 2:
                raise ConfigError(f"{path}: python-can could not read it again: leave out dots before {ending}")
            return make
    raise ConfigError(f"{path}: unsupported format; use one of {', '.join(WRITERS)}")


class Recorder:
    """A new recording and the thread that writes it.

    `put` never waits for the disk. Where the disk fails, falls behind by more than `waiting` messages or has less
    than `leave_mb` left, `put` and `close` raise TactileError, and the file holds all messages up to a point,
    which the error names. ConfigError for a `leave_mb` that is no bound.
    """

    def __init__(self, path: Path, waiting: int = WAITING, leave_mb: float = 0.0) -> None:
        if not 0 <= leave_mb < inf:
            raise ConfigError(f"recordings_leave_mb = {leave_mb:g}: give 0 (no bound) or more, in MB")
        self.path, self._most, self._leave_mb = path, waiting, leave_mb
        self.written = 0  # messages that are on the disk
        self._taken = 0
        self._queue: SimpleQueue[can.Message | None] = SimpleQueue()
        self._failed: str | None = None
        make = _writer(path)
        try:
            self._look_for_room()
            self._file = ChunkFile(path)
        except FileExistsError as error:
            raise ConfigError(f"{path} is there already: name another file, or remove it first") from error
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}: name a file that can be written") from error
        except TactileError as error:
            raise TactileError(f"{path}: {error}") from error
        self._writer = make(cast(BinaryIO, self._file))
        self._thread = Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def put(self, message: can.Message) -> None:
        """Take one message."""
        self.check()
        if self._queue.qsize() >= self._most:
            self._failed = f"the disk is too slow: {self._most} messages wait for it"
            self.check()
        self._queue.put(message)

    def check(self) -> None:
        """TactileError where the recording has ended before its time."""
        if self._failed is not None:
            raise TactileError(f"{self.path}: {self._failed}: the recording ends early: see that there is room")

    def close(self) -> None:
        """Write what waits and close the file; TactileError where not all of it is on the disk."""
        self._queue.put(None)
        self._thread.join()
        if self._failed is not None:
            raise TactileError(
                f"{self.path}: {self._failed}: the recording ends early, after {self.written} messages"
            )

    def _run(self) -> None:
        try:
            self._flush()  # the header
            self._write()
            self._end()
        except Exception as error:  # a writer raises what it likes on a message that its format does not know
            says = error.strerror if isinstance(error, OSError) else str(error)
            self._failed = " ".join((says or type(error).__name__).split())
            with suppress(OSError, TactileError):
                self._end()

    def _end(self) -> None:
        """Write the format's end and close the file, of which nothing more is written once the disk has failed."""
        self._writer.stop()
        self._file.close()
        if not self._file.failed:
            self.written = self._taken

    def _write(self) -> None:
        """Write what comes until None does; flush in time."""
        due = time.monotonic() + FLUSH_S
        while True:
            with suppress(Empty):
                message = self._queue.get(timeout=max(0.0, due - time.monotonic()))
                if message is None:
                    return
                self._writer.on_message_received(_plain(message))
                self._taken += 1
            if time.monotonic() >= due:
                self._flush()
                due = time.monotonic() + FLUSH_S

    def _flush(self) -> None:
        if isinstance(self._writer, can.BLFWriter):
            self._writer._flush()  # ends a container: python-can has no public way
        cast(Any, self._writer).file.flush()
        self.written = self._taken
        self._look_for_room()

    def _look_for_room(self) -> None:
        """TactileError where there is less room than is to be left."""
        if self._leave_mb and disk_usage(self.path.parent).free < self._leave_mb * 1e6:
            raise TactileError(f"less than {self._leave_mb:g} MB of its disk are free (recordings_leave_mb)")


def _plain(message: can.Message) -> can.Message:
    """The message with a channel that every format can say, or none."""
    name = "".join(str(message.channel or "").split())
    number = can.util.channel2int(name)
    message.channel = name if name and (number is None or number < 255) else None
    return message


def record(tap: Tap, recorder: Recorder, stop: Event, seconds: float = float("inf")) -> int:
    """Record a bus until `stop` or for `seconds`; returns how many messages are in the file.

    TactileError, with the file readable to the point that it names, where bus or disk ends it before.
    """
    now = due = time.monotonic()
    end = now + seconds
    try:
        while not stop.is_set() and now < end:
            message = tap.receive(min(end - now, POLL_S))
            if message is not None:
                recorder.put(message)
            if (now := time.monotonic()) >= due:
                recorder.check()
                tap.check()
                due = now + POLL_S
        tap.check()
    except BusError as error:
        recorder.close()
        raise BusError(f"{error}: the recording ends early, after {recorder.written} messages") from error
    finally:
        recorder.close()
    return recorder.written
