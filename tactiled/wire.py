"""Images as bytes: the binary messages of the stream; `docs/streams.md` describes them byte by byte."""

from math import prod
from struct import Struct
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import SensorImage
from tactiled.units import COUNTS, PRESSURE, Unit

Kept = Literal["raw", "restored", "shear"]  # what is kept of the last seconds
Kind = Literal[Kept, "traction"]
SHEARED: tuple[Kept, ...] = ("raw", "restored", "shear")  # what a 3-axis skin has
KINDS: tuple[Kind, ...] = (*SHEARED, "traction")
PRESSURES = SHEARED[:2]  # what every sensor has
UNITS: tuple[Unit, ...] = (PRESSURE, COUNTS)  # of pressures, by their number
METHOD_NAMES = ("", "idle", "raw", "wiener", "rl", "rl-fast", "nnls", "tv", "points", "learned")  # by their number
MAGIC, VERSION = b"TCTL", 1
HEADER = Struct("<4sBBHHHHHQddffffII")  # 64 bytes
LAYOUT = (  # offset, type, meaning
    (0, "4 bytes", "TCTL"),
    (4, "u8", f"version: {VERSION}"),
    (5, "u8", "kind: 0 raw, 1 restored, 2 shear, 3 traction (shear restored)"),
    (6, "u16", "rows; 1 of taxels that are not a grid"),
    (8, "u16", "columns"),
    (10, "u16", "F, number of flags: one per taxel in a raw image, else 0"),
    (12, "u16", "N, bytes of the sensor's name; 0 on a stream of one sensor"),
    (14, "u16", "unit of pressure and noise: 0 kPa, 1 counts, if the sensor is uncalibrated"),
    (16, "u64", "sequence number of the frame; it does not wrap, and lost frames leave gaps"),
    (24, "f64", "time of the frame's first CAN message, Unix time in s"),
    (32, "f64", "time at which the service made this message, Unix time in s"),
    (40, "f32", "noise: standard deviation of a raw taxel, in the unit of pressure"),
    (44, "f32", "noise gain: noise of the restored image divided by noise of the raw one"),
    (48, "f32", "resolution: finest half-period above the noise, mm"),
    (52, "f32", "time from counts to the restored image, microseconds"),
    (56, "u32", "iterations of the method"),
    (
        60,
        "u32",
        f"method used: {', '.join(f'{n} {name}' for n, name in enumerate(METHOD_NAMES) if n)}; 0 any other",
    ),
    (
        64,
        "f32 x rows x columns",
        "pressure in its unit, row by row, NaN if unknown; shear: counts, traction: kPa along x",
    ),
    (None, "f32 x rows x columns", "shear and traction only: the same along y"),
    (
        None,
        "u8 x F",
        "flags of each taxel, the sum of 1 missing, 2 reported faulty by the sensor, 4 dead, 8 saturated, "
        "16 beyond the calibrated range, 32 found faulty by the service, 64 far below zero",
    ),
    (None, "u8 x N", "the sensor's name"),
)


class Unpacked(NamedTuple):
    """One binary message."""

    kind: Kind
    sequence: int
    timestamp: float  # s, of the frame's first CAN message
    made_at: float  # s, Unix, of the message
    values: NDArray[np.float32]
    """In `unit`, (rows, columns), a layout in one row; shear (2, ...) in counts, traction in kPa."""
    flags: NDArray[np.uint8]  # (taxels,) for a raw image, else empty
    noise: float  # in `unit`
    noise_gain: float
    resolution_mm: float
    microseconds: float
    iterations: int
    method: str  # that was used; "": unknown
    unit: Unit  # of pressures
    sensor: str  # "" on a stream of one sensor


def values_of(image: SensorImage, kind: Kind) -> NDArray[np.float32]:
    """The values of a kind; ValueError where it has no shear. Traction that is not restored is NaN."""
    if kind == "traction" and image.traction is None:
        return np.full((2, *image.restored.shape), np.nan, np.float32)
    values: NDArray[np.float32] | None = getattr(image, kind)
    if values is None:
        raise ValueError(f"image {image.sequence} of {image.sensor}: no {kind}")
    return values


def pack(image: SensorImage, kind: Kind, made_at: float, sensor: str = "") -> bytes:
    """Give the message of one image; `made_at` is its time (s, Unix), `sensor` the name to put in."""
    values = values_of(image, kind)
    flags = image.flags.tobytes() if kind == "raw" else b""
    plane = values if kind in PRESSURES else values[0]
    rows, columns = plane.shape if plane.ndim == 2 else (1, plane.size)
    name = sensor.encode()
    head = HEADER.pack(
        MAGIC,
        VERSION,
        KINDS.index(kind),
        rows,
        columns,
        len(flags),
        len(name),
        UNITS.index(image.unit),
        image.sequence,
        image.time,
        made_at,
        image.noise,
        image.noise_gain,
        image.resolution_mm,
        image.microseconds,
        image.iterations,
        METHOD_NAMES.index(image.method) if image.method in METHOD_NAMES else 0,
    )
    return b"".join((head, values.astype("<f4", copy=False).tobytes(), flags, name))


def unpack(data: bytes) -> Unpacked:
    """Read one image; ValueError if it is not of this version."""
    if len(data) < HEADER.size or data[:4] != MAGIC or data[4] != VERSION:
        raise ValueError(f"{len(data)} bytes that begin with {data[:5]!r}: no stream message of version {VERSION}")
    _, _, kind, rows, columns, flagged, named, unit, *rest = HEADER.unpack_from(data)
    sequence, timestamp, made_at, noise, noise_gain, resolution_mm, microseconds, iterations, method = rest
    shape = (rows, columns) if kind < len(PRESSURES) else (2, rows, columns)
    end = HEADER.size + 4 * prod(shape)
    if unit >= len(UNITS):
        raise ValueError(f"unit {unit}: expected 0 or 1")
    if len(data) != end + flagged + named or kind >= len(KINDS):
        raise ValueError(f"{len(data)} bytes of kind {kind}: expected {end + flagged + named} of kind 0 to 3")
    values = np.frombuffer(data, "<f4", prod(shape), HEADER.size).reshape(shape)
    flags = np.frombuffer(data, np.uint8, flagged, end)
    return Unpacked(
        KINDS[kind], sequence, timestamp, made_at, values, flags,
        noise, noise_gain, resolution_mm, microseconds, iterations,
        METHOD_NAMES[method] if method < len(METHOD_NAMES) else "", UNITS[unit], data[end + flagged :].decode(),
    )  # fmt: skip
