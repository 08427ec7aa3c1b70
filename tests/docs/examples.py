"""Examples that the package itself computes."""

import contextlib
import re
import tempfile
from pathlib import Path

import numpy as np

from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.sniff import survey
from tactiled.cli.sniff import report
from tactiled.config.example import EXAMPLE
from tactiled.frames import MISSING, SATURATED, Message, SensorImage
from tactiled.wire import HEADER, LAYOUT, pack
from tests.cli.commands import run
from tests.docs.markdown import fenced

FLAGS = np.array([[0, SATURATED], [0, MISSING]], np.uint8)


def candump(message):
    mark = "##1" if message.fd else "#"  # 1: bit-rate switch
    return f"{message.id:03X}{mark}{message.data.hex().upper()}"


@fenced
def packed_classic():
    counts = np.array([0xABC, 0x123, 0xFFF, 0x001, 0x002, 0x003], np.uint16)
    return map(candump, Packed(len(counts), 12).encode(counts, 7, 0.0))


@fenced
def packed_fd():
    for codec, sequence in ((Packed(8, 10, True, 3), 255), (Packed(40, 16, True, 0), 0)):
        yield from map(candump, codec.encode(np.arange(codec.size, dtype=np.uint16), sequence, 0.0))


@fenced
def stream_example():
    """A raw image of several sensors' stream: offset, bytes, value, meaning."""
    raw = np.array([[0.0, 12.5], [3.25, np.nan]], np.float32)
    image = SensorImage(
        "palm", 5123, 1763712000.25, raw, raw, FLAGS, "nnls", "", 3, 62.0, 0.25, noise_gain=1.5, resolution_mm=1.0
    )
    data = pack(image, "raw", 1763712000.252, "palm")
    starts = [at for at, _, _ in LAYOUT if at is not None]  # the last is the header's end
    meanings = [re.split("[:;,]", text)[0] for _, _, text in LAYOUT]
    rows = [
        (starts[n], starts[n + 1], f"{field!r}", meanings[n]) for n, field in enumerate(HEADER.unpack_from(data))
    ]
    for n, pressure in enumerate(np.frombuffer(data, "<f4", 4, HEADER.size)):
        rows.append((HEADER.size + 4 * n, HEADER.size + 4 * n + 4, f"{pressure:g}", f"taxel {n}, kPa"))
    rows += [(80, 84, str(list(data[80:84])), "flags of the four taxels")]
    rows += [(84, len(data), repr(data[84:].decode()), "name of the sensor")]
    for at, end, value, text in rows:
        yield f"{at:3d}  {data[at:end].hex(' '):<24} {value:<18} {text}"


@fenced
def check():
    """What `tactiled check` prints of the file that `tactiled init` writes."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for verb in ("init", "check"):
            done = run(verb, "palm.toml", env={"COLUMNS": "100"})
            assert done.exit_code == 0, done.output
    return [line.rstrip() for line in done.output.splitlines()]


@fenced
def check_slips():
    """What `tactiled check` prints of the same file with three slips, but for its table."""
    slips = {"= 1.2": "= 0.0012", "mpa = 0.6": "mpa = 600000", "count = 0.05": "count = 50"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        text = EXAMPLE
        for right, wrong in slips.items():
            text = text.replace(right, wrong, 1)
        Path("palm.toml").write_text(text)
        done = run("check", "palm.toml")
        assert done.exit_code == 1, done.output
    return [line for line in done.output.splitlines() if line.startswith(("doubtful: ", "palm.toml "))]


@fenced
def sniff():
    """What `tactiled sniff` prints of two skins and a stranger, 3 s at 50 frames a second."""
    codecs, messages = (Packed(64, 12, fd=True, array_id=2), Icub(3, (1, 4))), []
    for sequence in range(150):
        for codec in codecs:
            encoded = codec.encode(np.full(codec.size, 60, np.uint16), sequence, 0.0)
            messages += [each._replace(time=sequence / 50 + n * 1e-4) for n, each in enumerate(encoded)]
        messages.append(Message(sequence / 50 + 0.01, 0x6A1, b"\x01"))
    messages.sort(key=lambda each: each.time)
    return report(survey(messages), f"{len(messages)} messages in 3 s")
