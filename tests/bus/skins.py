"""One codec of every kind, as tests of the bus use them."""

from pathlib import Path

import numpy as np

from tactiled.bus.codec import read_one
from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.cyskin import CySkin
from tactiled.bus.codecs.dbc import Dbc
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.linker_l30 import LinkerL30
from tactiled.bus.codecs.omnihand import OmniHand
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.poweron import PowerOn
from tactiled.bus.codecs.pushed import Pushed
from tactiled.bus.codecs.xela import Xela
from tactiled.frames import Message

CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.skin]
bus = "can0"
codec = {{ {codec} }}
array = {{ {array} }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
"""
DBC = Path(__file__).parent / "skin.dbc"
GRID = ("Row0.T0_0", "Row0.T0_1", "Row0.T0_2", "Row1.T1_0", "Row1.T1_1", "Row1.T1_2")
CODECS = {
    "packed": Packed(30, 12),
    "packed-fd": Packed(300, 10, fd=True, extended=True),
    "packed-odd": Packed(11, 13),
    "icub": Icub(3, (2, 0, 5)),
    "icub-fingertip": Icub(14, (0, 1), thermal_pads=False),
    "icub-palm": Icub(14, (8, 9), skin_type=1),
    "icub-ergocub": Icub(2, (0, 5, 4), skin_type=3),
    "xela": Xela(),
    "xela-2x8": Xela("current", 1, (0, 1), tuple(range(8))),
    "xela-4x4-old": Xela("4x4-old"),
    "xela-4x4-new": Xela("4x4-new"),
    "xela-4x6-old": Xela("4x6-old"),
    "xela-single": Xela("single"),
    "barrett": Barrett(11),
    "poweron": PowerOn(0x340),
    "cyskin": CySkin(),
    "linker": Linker("left", (1, 3)),
    "linker-o6": Linker("right", (1, 5), layout="10x4"),
    "linker-g20-5": Linker("right", (2, 3), layout="g20-5"),
    "linker-g20-7": Linker("left", (6, 1), layout="g20-7"),
    "linker-o20": Linker("left", (1, 5), layout="o20"),
    "linker_l30": LinkerL30(2, (1, 4)),
    "omnihand": OmniHand(1, parts=(1, 5)),
    "omnihand-palm": OmniHand(3, parts=(2, 6)),
    "pushed": Pushed(30),
    "dbc": Dbc(DBC, GRID),
    "dbc-pages": Dbc(DBC, ("Pages.P2", "Pages.P0", "Pages.P1")),
    "dbc-mixed": Dbc(DBC, ("Row0.T0_0", "Row1.T1_2", "Pages.P0", "Pages.P2", "Floats.F0", "Floats.Offset")),
}


def message(text, time=0.0):
    """A classic message, as candump writes it."""
    id_, data = text.split("#")
    return Message(time, int(id_, 16), bytes.fromhex(data))


def payloads_of(codec, messages):
    """The payloads of a frame in the order of its segments."""
    payloads = [None] * codec.segments
    for each in messages:
        reading = read_one(codec, each)
        payloads[reading.segment] = reading.payload
    return payloads


def counts_of(codec, *texts):
    """The counts of a frame of which these messages came."""
    return codec.unpack(payloads_of(codec, map(message, texts))).tolist()


def press(codec, sequence, rest=None, noise=2.0):
    """Counts of an array at rest with noise, a few taxels pressed."""
    rng = np.random.default_rng(sequence)
    rest = min(80, codec.full_scale // 2) if rest is None else rest
    counts = rest + rng.normal(0, noise, codec.size)
    counts[: max(1, codec.size // 20)] += codec.full_scale / 3
    return counts.clip(0, codec.full_scale).round().astype(np.uint16)


def traffic(codec, count=40, rate_hz=50.0, **pressed):
    """Frames as they come, a burst each."""
    for sequence in range(count):
        for n, each in enumerate(codec.encode(press(codec, sequence, **pressed), sequence, 0.0)):
            yield each._replace(time=sequence / rate_hz + n * 1e-4)
