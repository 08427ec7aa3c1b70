"""Recordings as python-can reads and writes them; read in bounded memory: no line or container may fill it."""

import codecs
import gzip
import io
import re
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any, BinaryIO, cast
from urllib.parse import quote

from tactiled.bus import textlog
from tactiled.bus.canbus import CanMessage, MessageWriter, blf, formats
from tactiled.bus.textlog import FormatError, Logged, Remarks

MAX_LINE_CHARACTERS = 1 << 16  # a message's line has some hundreds, whatever the format
MAX_BLOCK_BYTES = 16 << 20  # of a .blf file's container, packed or unpacked; most are of 128 KiB
PEEKED_BYTES = 512  # of a file, to tell its format
END_BYTES = 4096  # of either end, to tell its duration: over ten lines of messages
LINE_TIMES = {  # s, at the beginning of a message's line
    ".log": re.compile(rb"^\(([0-9]{1,12}\.[0-9]{1,12})\) ", re.MULTILINE),
    ".asc": re.compile(rb"^ *([0-9]{1,12}\.[0-9]{1,12}) +(?:CANFD +)?[0-9]+ ", re.MULTILINE),
}
PYTHON_CAN = bytes([5, 0, 0, 0, 2, 6, 8, 1])  # in the head of a .blf file that it wrote, in UTC
CAN_ERROR = 2  # an object of .blf; those of which python-can makes messages:
MESSAGES = {
    blf.CAN_MESSAGE, blf.CAN_MESSAGE2, blf.CAN_ERROR_EXT, blf.CAN_FD_MESSAGE, blf.CAN_FD_MESSAGE_64,
}  # fmt: skip
CONVERT = "convert it to candump's log, as SavvyCAN can"
WITH_LAST_END = (".log", ".asc")  # whose last line ends with a newline: without it the line may be cut off


class Lines(io.TextIOWrapper):
    """A text file whose lines are bounded: ValueError; EOFError for a last one without the end it should have."""

    def __init__(self, file: io.BufferedReader, with_last_end: bool, remarks: Remarks) -> None:
        wide = file.peek(2)[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # as PowerShell's > writes
        super().__init__(file, "utf-16" if wide else "utf-8-sig", "replace")  # comments are in any encoding
        self._with_last_end, self._remarks = with_last_end, remarks

    def readline(self, _: int | None = -1, /) -> str:  # type: ignore[override]
        """The next line."""
        line = super().readline(MAX_LINE_CHARACTERS + 1)
        if len(line) > MAX_LINE_CHARACTERS:
            raise ValueError(f"a line is longer than {MAX_LINE_CHARACTERS} characters")
        if self._with_last_end and line and not line.endswith("\n"):
            raise EOFError(textlog.LAST_LINE_CUT)
        if "\0" in line:  # as a crash leaves them where data had not reached the disk
            self._remarks.left_out[textlog.ZEROED] += 1
            return line.replace("\0", "")
        return line


class Blocks(io.BufferedReader):
    """A binary file that gives no more than a bound at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """The next `size` bytes, fewer at the end; ValueError where that is beyond the bound."""
        if size is None or not 0 <= size <= MAX_BLOCK_BYTES:
            raise ValueError(f"a block of {size} bytes: 0 to {MAX_BLOCK_BYTES} can be read")
        return super().read(size)


class BoundedBlf(formats.BLFReader):
    """python-can's reader of .blf, which unpacks a container and joins an object's parts whatever their size."""

    def __init__(self, file: Blocks, remarks: Remarks) -> None:
        start = file.peek(blf.FILE_HEADER_STRUCT.size)
        super().__init__(file)
        self._remarks = remarks
        if self.start_timestamp and start[8:16] != PYTHON_CAN:
            remarks.caveats.append(textlog.LOCAL_TIME)

    def __iter__(self) -> Iterator[CanMessage]:  # type: ignore[override]
        """Every message, of channels as in the file; EOFError where the file ends within an object."""
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
            packed = kind == blf.LOG_CONTAINER
            if not (packed and cut and len(data) < blf.LOG_CONTAINER_STRUCT.size):
                for message in self._parse_container(_unpacked(data) if packed else header + data):
                    message.channel = cast(int, message.channel) + 1
                    yield message
            if cut:
                raise EOFError("it is cut off")
        if self._tail.strip(b"\0"):
            raise EOFError("it is cut off")
        self.stop()

    def _parse_container(self, data: bytes) -> Iterator[CanMessage]:
        if len(self._tail) + len(data) > 2 * MAX_BLOCK_BYTES:
            raise ValueError(f"an object is longer than {MAX_BLOCK_BYTES} bytes")
        data, self._tail = self._tail + data, b""
        self._count_objects(data)
        return super()._parse_container(data)

    def _count_objects(self, data: bytes) -> None:
        """Count those of which no message is made; ValueError for one of an impossible size."""
        at, header = 0, blf.OBJ_HEADER_BASE_STRUCT
        while (at := data.find(b"LOBJ", at, at + 8)) >= 0 and at + header.size <= len(data):
            _, _, version, length, kind = header.unpack_from(data, at)
            if length < header.size:
                raise ValueError(f"an object has {length} bytes")
            if (at := at + length) > len(data):
                return
            if kind not in MESSAGES or version not in (1, 2):
                self._remarks.left_out[textlog.ERROR_FRAME if kind == CAN_ERROR else textlog.EVENT] += 1


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


TEXT_READERS = {".asc": textlog.asc, ".csv": textlog.csv, ".log": textlog.candump, ".trc": textlog.trc}
SIGNATURES = (  # formats by how their files begin: the endings under which they are read, and their names
    (rb"LOGG", (".blf",), "Vector's .blf"),
    (rb"MDF ", (".mf4",), "MF4"),
    (rb"SQLite format 3\0", (".db",), "a database"),
    (rb"(?i:date \w|base (hex|dec))", (".asc",), "Vector's .asc"),
    (rb";\$FILEVERSION=", (".trc",), "PEAK's .trc"),
    (rb"\([0-9]+\.[0-9]+\) \S+ [0-9A-Fa-f]+#", (".log",), "candump's log"),
    (rb"(interface = .*\s+)?(\(.*\)\s+)?\S+\s+((RX|TX).*\s+)?[0-9A-F]{3,8}\s+\[[0-9]+\]\s",
     (), "what candump prints on a screen: record with candump -l"),
    (rb"\x1f\x8b", (), "packed by gzip: name it with .gz at the end, as in a.log.gz"),
    (rb"PK\x03\x04", (), "a zip archive: unpack it"),
    (rb"(\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x4d\x3c\xb2\xa1|\x0a\x0d\x0d\x0a)", (),
     "a capture of Wireshark or tcpdump: record with candump -l"),
    (rb"Timestamp: +[0-9.]+ +ID: ", (), "what python-can prints on a screen: record with tactiled record"),
    (rb"\*\*\*BUSMASTER ", (), f"BUSMASTER's log: {CONVERT}"),
    (rb"Time Stamp,ID,Extended,", (), f"SavvyCAN's CSV: {CONVERT}"),
    (rb"[0-9]+\.[0-9]+ [0-9]?([RT](11|29)|C(?!AN)[A-Z]{2}) ", (), f"OVMS's CRTD: {CONVERT}"),
)  # fmt: skip


def _recognised(start: bytes, kind: str) -> None:
    """FormatError where a file begins as those of another format do; `kind` is its ending."""
    start = start.removeprefix(codecs.BOM_UTF8).lstrip(b"\0 \t\r\n")
    for pattern, endings, name in SIGNATURES:
        if re.match(pattern, start):
            if kind in endings:
                return
            raise FormatError(f"it is {name}" + (f": name it with {endings[0]}" if endings else ""))


def _kind(path: Path) -> tuple[str, bool]:
    """A recording's format by its name, and whether it is packed."""
    suffixes = [each.lower() for each in path.suffixes]
    packed = suffixes[-1:] == [".gz"]
    return "".join(suffixes[-2:-1] if packed else suffixes[-1:]), packed


def duration_s(path: Path) -> float | None:
    """Time (s) from the first to the last message by the two ends of a file; None where they do not tell it.

    They do not in a file that is packed or has times since the message before, nor in a .blf before its end.
    """
    kind, packed = _kind(path)
    if packed or kind not in (".blf", *LINE_TIMES):
        return None
    with path.open("rb") as file:
        head = file.read(END_BYTES)
        file.seek(max(0, file.seek(0, io.SEEK_END) - END_BYTES))
        tail = file.read(END_BYTES)
    times = []
    if kind == ".blf" and head.startswith(b"LOGG") and len(head) > blf.FILE_HEADER_STRUCT.size:
        dates = blf.FILE_HEADER_STRUCT.unpack_from(head)[-16:]
        times = [at for each in (dates[:8], dates[8:]) if (at := blf.systemtime_to_timestamp(each))]  # 0: no date
    elif kind in LINE_TIMES and b" relative" not in head:
        starts, ends = (LINE_TIMES[kind].findall(each) for each in (head, tail))
        times = [float(each) for each in (*starts[:1], *ends[-1:])]
    return times[1] - times[0] if len(times) == 2 and times[0] <= times[1] else None


def is_streamed(path: Path) -> bool:
    """Whether a recording is read from one end to the other, in a bounded memory."""
    return _kind(path)[0] in (*TEXT_READERS, ".blf")


@contextmanager
def open_log(path: Path, remarks: Remarks) -> Iterator[Iterable[Logged]]:
    """Open a recording in any format that python-can reads; errors are its own, those above, and OSError."""
    kind, packed = _kind(path)
    with path.open("rb") as file, gzip.GzipFile(fileobj=file) if packed else nullcontext(file) as source:
        buffered = cast(Blocks, source)
        _recognised(buffered.peek(PEEKED_BYTES)[:PEEKED_BYTES], kind)
        if kind in TEXT_READERS:
            with Lines(buffered, kind in WITH_LAST_END, remarks) as lines:
                yield TEXT_READERS[kind](lines, remarks)
            return
        if kind == ".blf":
            with Blocks(cast(io.RawIOBase, source)) as blocks:
                yield BoundedBlf(blocks, remarks)
            return
    if kind == ".db":
        _check_table(path)
    with formats.LogReader(path) as log:  # no stream of bytes, or no recording, which it says
        yield log


def _check_table(path: Path) -> None:
    """FormatError where a database is not python-can's."""
    with closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)) as database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
    if "messages" not in tables:
        others = f"only {', '.join(sorted(tables))}" if tables else "and no other"
        raise FormatError(f"it has no table 'messages', {others}: give a database that python-can wrote")


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
