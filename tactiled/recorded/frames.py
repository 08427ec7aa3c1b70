"""The frames of a recording in counts, in any order: another process decodes it once, into files on the disk.

So formats that can only be read from the beginning are no exception, and memory does not grow with the length.
"""

import os
import time
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import fields
from multiprocessing.reduction import DupFd
from operator import attrgetter
from pathlib import Path
from shutil import disk_usage
from tempfile import TemporaryFile
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codec import Codec
from tactiled.bus.recording import END_CUT, Recording
from tactiled.bus.replay import AT_ONCE, frames
from tactiled.bus.router import Router
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Loss, RawFrame
from tactiled.processes import Cancelled, FitProcess
from tactiled.threads import join_started

FLUSH_S = 0.1  # longest time until a decoded frame can be read
LOSSES = tuple(each.name for each in fields(Loss))
HEAD = np.dtype(
    [
        ("position", "<f8"),  # s, in the recording
        ("time", "<f8"),
        ("skew", "<f8"),
        ("sequence", "<i8"),
        ("offset", "<i8"),  # of its arrays in their file, bytes
        ("total", "<f8"),  # of its counts
        ("content", "u1"),
        ("loss", "<i8", (len(LOSSES),)),
    ]
)
FLOATS, FLAGS, SHEAR = 1, 2, 4  # bits of `content`: float32 counts, not uint16; flags other than 0; shear
_losses = attrgetter(*LOSSES)


class SharedFile:
    """A file without a name, which ends with the service; one other process may write it."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self.write, self.flush, self.close = file.write, file.flush, file.close

    @classmethod
    def temporary(cls, folder: Path) -> "SharedFile":
        """A new one; OSError where the folder takes no files."""
        return cls(TemporaryFile(dir=folder, buffering=0))

    def __reduce__(self) -> Any:
        return _reopened, (DupFd(self._file.fileno()),)

    def duplicate(self) -> "SharedFile":
        """A second handle of the file, which stays open when this one is closed."""
        return SharedFile(os.fdopen(os.dup(self._file.fileno()), "rb", 0))

    @property
    def size(self) -> int:
        """Bytes by now."""
        return os.fstat(self._file.fileno()).st_size

    def read(self, size: int, offset: int) -> bytes:
        """Up to `size` bytes from an offset on."""
        return os.pread(self._file.fileno(), size, offset)


def _reopened(duplicate: Any) -> Any:
    return SharedFile(os.fdopen(duplicate.detach(), "wb"))


class _Writer:
    """Writes the frames of one sensor: first arrays, then heads, so that whoever finds a head finds its arrays."""

    def __init__(self, heads: SharedFile, arrays: SharedFile) -> None:
        self._heads, self._arrays = heads, arrays
        self._pending = bytearray()
        self._offset = 0

    def add(self, frame: RawFrame) -> None:
        counts = frame.counts
        parts: list[NDArray[Any]] = [counts]
        content = FLOATS if counts.dtype == np.float32 else 0
        if frame.flags.any():
            content |= FLAGS
            parts.append(frame.flags)
        if frame.shear is not None:
            content |= SHEAR
            parts.append(np.asarray(frame.shear, np.float32))
        head = frame.arrived, frame.time, frame.skew, frame.sequence, self._offset, counts.sum(), content
        self._pending += np.array((*head, _losses(frame.loss)), HEAD).tobytes()
        self._offset += sum(self._arrays.write(each.tobytes()) for each in parts)

    def write_out(self) -> None:
        self._arrays.flush()
        self._heads.write(self._pending)
        self._heads.flush()
        self._pending.clear()


def write_frames(
    path: Path, codecs: Mapping[str, Codec], files: Mapping[str, tuple[SharedFile, SharedFile]], leave_mb: float
) -> tuple[str, list[str]]:
    """Write every frame of a recording; returns how its end is cut off ("": it is whole), and its other caveats.

    ConfigError where its content is wrong; another TactileError where it cannot be read, or the disk is full.
    """
    router = Router(codecs)
    recording, writers = Recording(path, router.ids), {name: _Writer(*each) for name, each in files.items()}
    parent, flushed = os.getppid(), time.monotonic()
    try:
        for name, frame in frames(recording, router, AT_ONCE):
            writers[name].add(frame)
            if time.monotonic() - flushed > FLUSH_S:
                for each in writers.values():
                    each.write_out()
                flushed = time.monotonic()
                check_goes_on(parent, path.parent, leave_mb)
    except ConfigError as error:
        if isinstance(error.__cause__, OSError):
            raise TactileError(str(error)) from error
        raise
    finally:
        for each in writers.values():
            each.write_out()
    return END_CUT * recording.torn, recording.caveats()


def check_goes_on(parent: int, folder: Path, leave_mb: float) -> None:
    """TactileError where the process that wants the files has ended, or their disk is full."""
    if disk_usage(folder).free < leave_mb * 1e6:
        raise TactileError(f"less than {leave_mb:g} MB of its disk are free (recordings_leave_mb)")
    if os.getppid() != parent:
        raise TactileError("the service ended")


def _version(path: Path) -> tuple[int, int]:
    """Time of change and size: they differ after a file was written again."""
    status = path.stat()
    return status.st_mtime_ns, status.st_size


class FrameFiles:
    """The frames of a recording's sensors, as far as they are written; another process may read them, too."""

    def __init__(self, sizes: Mapping[str, int], files: Mapping[str, tuple[SharedFile, SharedFile]]) -> None:
        """`sizes`: taxels of each sensor; `files`: its heads and its arrays."""
        self._sizes, self._files = sizes, files

    def of(self, sensor: str) -> "FrameFiles":
        """Those of one sensor."""
        return FrameFiles({sensor: self._sizes[sensor]}, {sensor: self._files[sensor]})

    def count(self, sensor: str) -> int:
        """Frames of a sensor by now."""
        return self._files[sensor][0].size // HEAD.itemsize

    def heads(self, sensor: str, first: int = 0, count: int | None = None) -> NDArray[Any]:
        """The heads (of type HEAD) of `count` frames from `first` on; None: of all that follow."""
        count = self.count(sensor) if count is None else count
        return np.frombuffer(self._files[sensor][0].read(count * HEAD.itemsize, first * HEAD.itemsize), HEAD)

    def at(self, sensor: str, position_s: float) -> int:
        """Number of the last frame at or before a position, 0 if there is none. The sensor must have a frame."""
        every = range(self.count(sensor))
        later = bisect_right(every, position_s, key=lambda n: float(self.heads(sensor, n, 1)["position"][0]))
        return max(0, later - 1)

    def frame(self, sensor: str, number: int) -> RawFrame:
        """A frame that is written already."""
        (head,) = self.heads(sensor, number, 1)
        size, content = self._sizes[sensor], int(head["content"])
        counts_type = np.dtype("<f4" if content & FLOATS else "<u2")
        flags_at = counts_type.itemsize * size
        shear_at = flags_at + (size if content & FLAGS else 0)
        data = self._files[sensor][1].read(shear_at + (8 * size if content & SHEAR else 0), int(head["offset"]))
        return RawFrame(
            sequence=int(head["sequence"]),
            time=float(head["time"]),
            skew=float(head["skew"]),
            counts=np.frombuffer(data, counts_type, size),
            flags=np.frombuffer(data, np.uint8, size, flags_at) if content & FLAGS else np.zeros(size, np.uint8),
            loss=Loss(*map(int, head["loss"])),
            shear=np.frombuffer(data, "<f4", 2 * size, shear_at).reshape(2, size) if content & SHEAR else None,
            arrived=float(head["position"]),
        )


class RecordedFrames(FrameFiles):
    """The frames of a recording's sensors; more come while `reading`. `codecs` are of one bus."""

    def __init__(self, path: Path, codecs: Mapping[str, Codec], leave_mb: float = 0.0) -> None:
        """OSError where its folder takes no files."""
        self.path, self.leave_mb, self._made_of, self.used_at = path, leave_mb, (_version(path), codecs), 0.0
        files = {name: (SharedFile.temporary(path.parent), SharedFile.temporary(path.parent)) for name in codecs}
        super().__init__({name: each.size for name, each in codecs.items()}, files)
        self.error = ""  # why the recording, or reading it, ended early
        self.caveats: list[str] = []  # once it is read: what was left out of it, or is in doubt
        self._may_pass = self.answered = False  # whether `error` may pass, and a client was told of it
        self._process = FitProcess()
        self._thread = Thread(target=self._read, args=(codecs,), name=f"read {path.name}", daemon=True)
        self._thread.start()

    def is_of(self, codecs: Mapping[str, Codec]) -> bool:
        """Whether these codecs would read the same from the file as it is now; OSError where it is not there."""
        return self._made_of == (_version(self.path), codecs)

    @property
    def reading(self) -> bool:
        """Whether more frames may come."""
        return self._thread.is_alive()

    @property
    def failed(self) -> bool:
        """Whether nothing was read for a reason that may pass: rights, memory or a disk."""
        return not self.reading and self._may_pass and not any(map(self.count, self._files))

    def close(self) -> None:
        """End reading, and free the disk."""
        self._process.cancel()
        join_started(self._thread)
        for each in self._files.values():
            for file in each:
                file.close()

    def _read(self, codecs: Mapping[str, Codec]) -> None:
        try:
            self.error, self.caveats = self._process.run(
                write_frames, self.path, codecs, self._files, self.leave_mb
            )
        except Cancelled:
            pass
        except Exception as error:
            self.error, self._may_pass = str(error), not isinstance(error, ConfigError)
