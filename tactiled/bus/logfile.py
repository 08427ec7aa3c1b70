"""Recordings as python-can reads them, but in bounded memory: no line or container may fill it."""

import gzip
import io
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, cast

import can
from can.io import blf
from can.io.generic import MessageReader

MAX_LINE = 1 << 16  # characters; a message's line has some hundreds, whatever the format
MAX_BLOCK_BYTES = 16 << 20  # of a .blf file's container, packed or unpacked; most are of 128 KiB
TEXT = {".log": can.CanutilsLogReader, ".asc": can.ASCReader, ".csv": can.CSVReader, ".trc": can.TRCReader}
ENDED = (".log", ".asc")  # of whose lines the last one has an end, too: without it a message may be half of one


class Lines(io.TextIOWrapper):
    """A text file whose lines are bounded: ValueError; EOFError for a last one without the end it should have."""

    def __init__(self, file: BinaryIO, ended: bool) -> None:
        super().__init__(file, "utf-8")
        self._ended = ended

    def readline(self, _: int | None = -1, /) -> str:  # type: ignore[override]
        """The next line."""
        line = super().readline(MAX_LINE + 1)
        if len(line) > MAX_LINE:
            raise ValueError(f"a line is longer than {MAX_LINE} characters")
        if self._ended and line and not line.endswith("\n"):
            raise EOFError("its last line is cut off")
        return line


class Blocks(io.BufferedReader):
    """A binary file that gives no more than a bound at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """The next `size` bytes, fewer at the end; ValueError where that is beyond the bound."""
        if size is None or not 0 <= size <= MAX_BLOCK_BYTES:
            raise ValueError(f"a block of {size} bytes: 0 to {MAX_BLOCK_BYTES} can be read")
        return super().read(size)


class BoundedBlf(can.BLFReader):
    """python-can's reader of .blf, which unpacks a container and joins an object's parts whatever their size."""

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override]
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

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
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


def open_log(path: Path) -> MessageReader:
    """Open a recording in any format that python-can reads; errors are its own, those above, and OSError."""
    suffixes = [each.lower() for each in path.suffixes]
    packed = len(suffixes) == 2 and suffixes[1] == ".gz"
    kind = "".join(suffixes[:1] if packed else suffixes[-1:])
    if kind not in TEXT and kind != ".blf":
        return can.LogReader(path)  # no stream of bytes, or no recording, which it says
    source = gzip.GzipFile(path) if packed else path.open("rb")
    file = Blocks(cast(io.RawIOBase, source)) if kind == ".blf" else Lines(cast(BinaryIO, source), kind in ENDED)
    try:
        return BoundedBlf(file) if isinstance(file, Blocks) else TEXT[kind](file)
    except BaseException:
        file.close()
        raise
