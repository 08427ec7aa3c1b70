"""What fuzzing holds every codec and the assembler to: bytes become a bus, and an oracle reads it, too."""

from itertools import pairwise
from pathlib import Path

import numpy as np

from tactiled.bus.assembler import Assembler
from tactiled.bus.codec import read_one
from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.cyskin import CySkin
from tactiled.bus.codecs.dbc import Dbc
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.poweron import PowerOn
from tactiled.bus.codecs.xela import Xela
from tactiled.errors import CodecError
from tactiled.frames import BAD, MISSING, Message
from tests.bus.skins import DBC

CORPUS = Path(__file__).parent / "corpus"
DBC_TAXELS = ("Row0.T0_0", "Row1.T1_2", "Pages.P0", "Pages.P2", "Floats.F0", "Doubles.D0")
SKINS = {
    "packed": Packed(10, 12),
    "packed-fd": Packed(90, 11, fd=True, extended=True),
    "icub": Icub(3, (2, 0)),
    "xela": Xela("current", 1, (1, 0), (0, 1)),
    "barrett": Barrett(11),
    "poweron": PowerOn(),
    "cyskin": CySkin(),
    "linker": Linker("left", (2,)),
    "dbc": Dbc(DBC, DBC_TAXELS),
}
GOOD_FRAMES = 24  # frames of a good sender, after which it begins again


def _good(codec):
    """Messages of a sender without fault, every frame with values of its own."""
    rows = (np.arange(codec.size) * 3 + n * 7 for n in range(GOOD_FRAMES))
    counts = ((row % (min(codec.full_scale, 255) + 1)).astype(np.uint16) for row in rows)
    return [each for n, row in enumerate(counts) for each in codec.encode(row, n, 0.0)]


GOOD = {name: _good(codec) for name, codec in SKINS.items()}
SPANS = {
    name: [np.arange(codec.size)[codec.span(at)].tolist() for at in range(codec.segments)]
    for name, codec in SKINS.items()
}
IDS = {name: sorted(codec.ids) for name, codec in SKINS.items()}
LENGTHS = (8, 8, 8, 8, 0, 1, 2, 3, 4, 5, 6, 7, 12, 16, 24, 64)


def bus(name, data):
    """The messages that bytes stand for: good ones in order, lost, repeated, swapped, bent; None for a silence."""
    good, ids = GOOD[name], IDS[name]
    rest, at = iter(data), 0
    for byte in rest:
        kind, how = byte & 3, byte >> 2
        if byte == 0xFF:
            yield None
        elif kind == 0:  # the next one, some lost before it
            at += max(0, how - 48)
            yield good[at % len(good)]
            at += 1
        elif kind == 1:  # one from before, or from ahead
            yield good[(at - 1 - how % 8 + (how >> 3)) % len(good)]
        elif kind == 2:  # the next one with a byte changed, or cut short
            message, where = good[at % len(good)], next(rest, 0)
            bent = bytearray(message.data)
            bent[where % len(bent)] ^= next(rest, 1)
            yield message._replace(data=bytes(bent[: len(bent) - how % 2]))
            at += how >> 5
        else:  # any bytes on one of its ids
            id_, extended = ids[next(rest, 0) % len(ids)]
            body = bytes(each for _, each in zip(range(LENGTHS[how & 15]), rest, strict=False))
            yield Message(0.0, id_, body, extended, bool(how & 16))


def corpus(name):
    """Inputs worth keeping, as coverage found them."""
    return [bytes.fromhex(line) for line in (CORPUS / f"{name}.hex").read_text().splitlines()]


class WrongError(AssertionError):
    """A frame says what its messages did not."""


def check(name, data):
    """Put `data`'s bus through codec and assembler; WrongError where a frame is not what its messages said."""
    codec = SKINS[name]
    assembler, readings, frames, time = Assembler(codec), [], [], 0.0
    for message in bus(name, data):
        time += 1.0 if message is None else 0.01
        if message is None:
            frames += assembler.flush(time - 0.05)
            continue
        try:
            reading = read_one(codec, message._replace(time=time))
        except CodecError:
            continue
        readings.append(reading)
        frames += [frame for _, frame in assembler.push(message._replace(time=time))]
    frames += assembler.flush(float("inf"))
    ends = [frame.time + frame.skew for frame in frames]
    for frame, end in zip(frames, ends, strict=True):
        _judge(name, frame, [each for each in readings if frame.time <= each.time <= end + 1e-9])
    _judge_all(codec, assembler, frames, ends, readings)
    return frames, assembler.loss


def _judge(name, frame, within):
    """Hold a frame to the readings of its sequence number that came while it was open, once or the same again."""
    codec = SKINS[name]
    payloads, flags, bad = [None] * codec.segments, bytearray((MISSING,)) * codec.size, []
    own = [reading for reading in within if reading.sequence == within[0].sequence]
    for reading in own:
        if any(each.segment == reading.segment and each.payload != reading.payload for each in own):
            continue
        payloads[reading.segment] = reading.payload
        bad += reading.bad
        for taxel in SPANS[name][reading.segment]:
            flags[taxel] = 0
    for taxel in bad:
        flags[taxel] |= BAD
    if frame.flags.tobytes() != flags:
        raise WrongError(f"flags {frame.flags.tolist()}, and {list(flags)} is what came")
    counts = codec.unpack(payloads)
    if frame.counts.tobytes() != counts.tobytes():
        raise WrongError(f"counts {frame.counts.tolist()}, and {counts.tolist()} is what came")
    if counts.dtype == np.uint16 and max(counts.tolist()) > codec.full_scale:
        raise WrongError(f"counts {counts.tolist()} of {codec.full_scale}")


def _judge_all(codec, assembler, frames, ends, readings):
    """Hold what frames have in common: order, no message in two of them, every message counted."""
    if any(after.time <= end for (_, after), end in zip(pairwise(frames), ends, strict=False)):
        raise WrongError("two frames were open at once")
    if any(after.sequence <= before.sequence for before, after in pairwise(frames)):
        raise WrongError("sequence numbers do not rise")
    marked = sum(any(flag & MISSING for flag in frame.flags.tobytes()) for frame in frames)
    if assembler.loss.incomplete != marked:
        raise WrongError(f"incomplete = {assembler.loss.incomplete}, and {marked} frames have gaps")
    if codec.modulus is None:
        used = len(frames) * codec.segments - assembler.loss.lost
        if used != len(readings) or assembler.loss.repeated or assembler.loss.late:
            raise WrongError(f"{used} messages are in frames, and {len(readings)} came")
