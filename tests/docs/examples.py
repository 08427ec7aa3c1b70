"""Examples that the package itself computes."""

import contextlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.sniff import survey as recognise
from tactiled.cli.app import app
from tactiled.cli.sniff import report
from tactiled.frames import MISSING, SATURATED, Image, Message
from tactiled.wire import HEADER, LAYOUT, pack

CLASSIC = [0xABC, 0x123, 0xFFF, 0x001, 0x002, 0x003]
FLAGS = np.array([[0, SATURATED], [0, MISSING]], np.uint8)
FD_FLAG = 1  # as candump writes it: bit-rate switch


def candump(message: Message) -> str:
    return f"{message.id:03X}{f'##{FD_FLAG}' if message.fd else '#'}{message.data.hex().upper()}"


def fenced(lines: Iterator[str]) -> Iterator[str]:
    yield "```text"
    yield from lines
    yield "```"


def packed_classic() -> Iterator[str]:
    codec = Packed(len(CLASSIC), 12)
    yield from fenced(map(candump, codec.encode(np.array(CLASSIC, np.uint16), 7, 0.0)))


def packed_fd() -> Iterator[str]:
    yield from fenced(
        candump(message)
        for codec, sequence in ((Packed(8, 10, True, 3), 255), (Packed(40, 16, True, 0), 0))
        for message in codec.encode(np.arange(codec.size, dtype=np.uint16), sequence, 0.0)
    )


def image() -> Image:
    raw = np.array([[0.0, 12.5], [3.25, np.nan]], np.float32)
    told = {"method": "nnls", "why": "", "iterations": 3, "microseconds": 62.0, "noise_kpa": 0.25}
    return Image("palm", 5123, 1763712000.25, raw, raw, FLAGS, noise_gain=1.5, resolution_mm=1.0, **told)


def stream_message() -> Iterator[str]:
    """A raw image of several sensors' stream: offset, bytes, what they say."""
    data = pack(image(), "raw", 1763712000.252, "palm")
    fields = HEADER.unpack_from(data)
    starts = [at for at, _, _ in LAYOUT if at is not None]  # the last is the header's end
    about = [re.split("[:;,]", means)[0] for _, _, means in LAYOUT]
    rows = [(starts[n], starts[n + 1], f"{field!r}", about[n]) for n, field in enumerate(fields)]
    pressures = np.frombuffer(data, "<f4", 4, HEADER.size)
    rows += [
        (at := HEADER.size + 4 * n, at + 4, f"{each:g}", f"taxel {n}, kPa") for n, each in enumerate(pressures)
    ]
    rows += [(80, 84, str(list(data[80:84])), "flags of the four taxels")]
    rows += [(84, len(data), repr(data[84:].decode()), "name of the sensor")]
    yield from fenced(
        f"{at:3d}  {data[at:end].hex(' '):<24} {value:<18} {means}" for at, end, value, means in rows
    )


def check() -> Iterator[str]:
    """What `tactiled check` prints of the file that `tactiled init` writes."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for verb in ("init", "check"):
            done = CliRunner().invoke(app, [verb, "palm.toml"], env={"COLUMNS": "100"}, catch_exceptions=False)
            assert done.exit_code == 0, done.output
        assert Path("palm.toml").exists()
    yield from fenced(line.rstrip() for line in done.output.splitlines())


def sniff() -> Iterator[str]:
    """What `tactiled sniff` prints of two skins and a stranger, 3 s at 50 frames a second."""
    codecs, heard = (Packed(64, 12, fd=True, array_id=2), Icub(3, (1, 4))), []
    for sequence in range(150):
        for codec in codecs:
            sent = codec.encode(np.full(codec.size, 60, np.uint16), sequence, 0.0)
            heard += [each._replace(time=sequence / 50 + n * 1e-4) for n, each in enumerate(sent)]
        heard.append(Message(sequence / 50 + 0.01, 0x6A1, b"\x01"))
    heard.sort(key=lambda each: each.time)
    yield from fenced(iter(report(recognise(heard), len(heard), 3.0)))
