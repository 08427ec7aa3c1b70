"""Images as bytes: the binary messages of the stream; the README describes them byte by byte."""

from struct import Struct
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Image

Kind = Literal["raw", "restored"]
KINDS: tuple[Kind, ...] = ("raw", "restored")
MAGIC, VERSION = b"TCTL", 1
HEADER = Struct("<4sBBHHHHHQddffffII")  # 64 bytes


class Unpacked(NamedTuple):
    """What one binary message says."""

    kind: Kind
    sequence: int
    timestamp: float  # s, of the frame's first CAN message
    sent: float  # s, when the message was made
    values: NDArray[np.float32]  # kPa, (rows, columns); one row where the layout is no grid
    flags: NDArray[np.uint8]  # (taxels,) for a raw image, empty for a restored one
    noise_kpa: float
    noise_gain: float
    resolution_mm: float
    microseconds: float
    iterations: int
    sensor: str  # "" on a stream of one sensor


def pack(image: Image, kind: Kind, sent: float, sensor: str = "") -> bytes:
    """Give the message of one image; `sent` is the time (s, Unix) it is made at, `sensor` the name to put in."""
    values = image.raw if kind == "raw" else image.restored
    flags = image.flags.tobytes() if kind == "raw" else b""
    rows, columns = values.shape if values.ndim == 2 else (1, values.size)
    name = sensor.encode()
    head = HEADER.pack(
        MAGIC,
        VERSION,
        KINDS.index(kind),
        rows,
        columns,
        len(flags),
        len(name),
        0,
        image.sequence,
        image.time,
        sent,
        image.noise_kpa,
        image.noise_gain,
        image.resolution_mm,
        image.microseconds,
        image.iterations,
        0,
    )
    return b"".join((head, values.astype("<f4", copy=False).tobytes(), flags, name))


def unpack(data: bytes) -> Unpacked:
    """Read one message; ValueError where it is none of this version."""
    if len(data) < HEADER.size or data[:4] != MAGIC or data[4] != VERSION:
        raise ValueError(f"{len(data)} bytes that begin with {data[:5]!r}: no stream message of version {VERSION}")
    _, _, kind, rows, columns, flagged, named, _, *rest = HEADER.unpack_from(data)
    sequence, timestamp, sent, noise_kpa, noise_gain, resolution_mm, microseconds, iterations, _ = rest
    end = HEADER.size + 4 * rows * columns
    if len(data) != end + flagged + named or kind >= len(KINDS):
        raise ValueError(f"{len(data)} bytes of kind {kind}: expected {end + flagged + named} of kind 0 or 1")
    values = np.frombuffer(data, "<f4", rows * columns, HEADER.size).reshape(rows, columns)
    flags = np.frombuffer(data, np.uint8, flagged, end)
    return Unpacked(
        KINDS[kind], sequence, timestamp, sent, values, flags,
        noise_kpa, noise_gain, resolution_mm, microseconds, iterations, data[end + flagged :].decode(),
    )  # fmt: skip
