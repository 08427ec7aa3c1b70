"""Recordings as python-can reads and writes them; read in bounded memory: no line or container may fill it."""

import gzip
import io
import re
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, BinaryIO, cast

from tactiled.bus.canbus import CanMessage, MessageReader, MessageWriter, blf, formats
from tactiled.frames import Message

MAX_LINE_CHARACTERS = 1 << 16  # a message's line has some hundreds, whatever the format
MAX_BLOCK_BYTES = 16 << 20  # of a .blf file's container, packed or unpacked; most are of 128 KiB
CANDUMP_LINE = re.compile(
    r"\(([0-9]+\.[0-9]+)\) ([^\s]+) ([0-9A-Fa-f]{3}|[01][0-9A-Fa-f]{7})"
    r"#(?:(#)[0-9])?((?:[0-9A-Fa-f]{2})*)(?: [RT])?\n"
)
Logged = tuple[str, Message] | CanMessage  # of a channel; or as python-can has it
WITH_LAST_END = (".log", ".asc")  # whose last line has an end, too: without it a message may be half of one


class Lines(io.TextIOWrapper):
    """A text file whose lines are bounded: ValueError; EOFError for a last one without the end it should have."""

    def __init__(self, file: BinaryIO, with_last_end: bool) -> None:
        super().__init__(file, "utf-8")
        self._with_last_end = with_last_end

    def readline(self, _: int | None = -1, /) -> str:  # type: ignore[override]
        """The next line."""
        line = super().readline(MAX_LINE_CHARACTERS + 1)
        if len(line) > MAX_LINE_CHARACTERS:
            raise ValueError(f"a line is longer than {MAX_LINE_CHARACTERS} characters")
        if self._with_last_end and line and not line.endswith("\n"):
            raise EOFError("its last line is cut off")
        return line


class CandumpLog(formats.CanutilsLogReader):
    """Data frames as candump and python-can write them are read here, any other line by python-can."""

    def __iter__(self) -> Iterator[Logged]:  # type: ignore[override]
        """Every message, error and remote frame."""
        for line in self.file:
            if (match := CANDUMP_LINE.fullmatch(line)) is None:
                yield from formats.CanutilsLogReader(io.StringIO(line))
                continue
            time, channel, id_, fd, data = match.groups()
            yield channel, Message(float(time), int(id_, 16), bytes.fromhex(data), len(id_) > 3, fd is not None)


class Blocks(io.BufferedReader):
    """A binary file that gives no more than a bound at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """The next `size` bytes, fewer at the end; ValueError where that is beyond the bound."""
        if size is None or not 0 <= size <= MAX_BLOCK_BYTES:
            raise ValueError(f"a block of {size} bytes: 0 to {MAX_BLOCK_BYTES} can be read")
        return super().read(size)


class BoundedBlf(formats.BLFReader):
    """python-can's reader of .blf, which unpacks a container and joins an object's parts whatever their size."""

    def __iter__(self) -> Iterator[CanMessage]:  # type: ignore[override]
        """Every message; EOFError where the file ends within an object."""
        size = blf.OBJ_HEADER_BASE_STRUCT.size
        while header := self.file.read(size):
            if len(header) < size:
                raise EOFError("it is cut off")
            signature, _, _, length, kind = blf.OBJ_HEADER_BASE_STRUCT.unpack(header)
            if signature != b"LOBJ":
                raise blf.BLFParseError("no object where one must begin")
            data = self.file.read(length - size)
            self.file.read(length % 4)
            cut = len(data) < length - size
            if kind == blf.LOG_CONTAINER and not (cut and len(data) < blf.LOG_CONTAINER_STRUCT.size):
                yield from self._parse_container(_unpacked(data))
            if cut:
                raise EOFError("it is cut off")
        self.stop()

    def _parse_container(self, data: bytes) -> Iterator[CanMessage]:
        if len(self._tail) + len(data) > 2 * MAX_BLOCK_BYTES:
            raise ValueError(f"an object is longer than {MAX_BLOCK_BYTES} bytes")
        return super()._parse_container(data)


def _unpacked(container: bytes) -> bytes:
    """A container's objects; ValueError where they are too many, or packed in an unknown way."""
    if len(container) < blf.LOG_CONTAINER_STRUCT.size:
        raise ValueError(f"a container has {len(container)} bytes")
    method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(container)
    content = container[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return content
    if method != blf.ZLIB_DEFLATE:
        raise ValueError(f"a container is packed by the unknown method {method}")
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(content, MAX_BLOCK_BYTES)
    if unpacking.unconsumed_tail:
        raise ValueError(f"a container unpacks to more than {MAX_BLOCK_BYTES} bytes")
    return data


TEXT_READERS: dict[str, Callable[[Any], MessageReader]] = {
    ".asc": formats.ASCReader,
    ".csv": formats.CSVReader,
    ".log": CandumpLog,
    ".trc": formats.TRCReader,
}


def open_log(path: Path) -> AbstractContextManager[Iterable[Logged]]:
    """Open a recording in any format that python-can reads; errors are its own, those above, and OSError."""
    suffixes = [each.lower() for each in path.suffixes]
    packed = len(suffixes) == 2 and suffixes[1] == ".gz"
    kind = "".join(suffixes[:1] if packed else suffixes[-1:])
    if kind not in (*TEXT_READERS, ".blf"):
        return formats.LogReader(path)  # no stream of bytes, or no recording, which it says
    source = gzip.GzipFile(path) if packed else path.open("rb")
    try:
        if kind == ".blf":
            return BoundedBlf(Blocks(cast(io.RawIOBase, source)))
        return TEXT_READERS[kind](Lines(cast(BinaryIO, source), kind in WITH_LAST_END))
    except BaseException:
        source.close()
        raise


def _text(file: BinaryIO, compressed: bool = False) -> io.TextIOWrapper:
    packed = cast(BinaryIO, gzip.GzipFile("", "wb", 6, file, 0)) if compressed else file
    return io.TextIOWrapper(packed, "utf-8", newline="\n")


def _candump(file: BinaryIO, compressed: bool = False) -> MessageWriter:
    writer = formats.CanutilsLogWriter(_text(file, compressed), "can0")
    writer.last_timestamp = 0.0  # of no message: the first one's would take the place of all that are before it
    return writer


WRITERS: dict[str, Callable[[BinaryIO], MessageWriter]] = {
    ".log": _candump,
    ".asc": lambda file: formats.ASCWriter(_text(file)),
    ".blf": formats.BLFWriter,
    ".log.gz": lambda file: _candump(file, compressed=True),
    ".asc.gz": lambda file: formats.ASCWriter(_text(file, compressed=True)),
}  # python-can's formats that keep all of a message and can be read without their end


def flush(writer: MessageWriter) -> None:
    """Hand all that a writer was given to its file."""
    if isinstance(writer, formats.BLFWriter):
        writer._flush()  # ends a container: python-can has no public way
    cast(Any, writer).file.flush()
