"""A bus that loses, doubles, reorders and garbles: no frame is wrong and unmarked."""

import random
from pathlib import Path

import numpy as np
import pytest

from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.cyskin import CySkin
from tactiled.bus.codecs.dbc import Dbc
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.poweron import PowerOn
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.router import Router
from tactiled.frames import MISSING, Message

FRAMES = 400
LEARNING = 40  # frames within which a skin without sequence numbers may be read askew
CODECS = {
    "packed": Packed(30, 12),
    "packed fd": Packed(300, 10, fd=True),
    "icub": Icub(3, (0, 2, 5)),
    "barrett": Barrett(3),
    "poweron": PowerOn(),
    "cyskin": CySkin(),
    "linker": Linker("left", (1, 2)),
    "xela": Xela(),
    "dbc": Dbc(
        Path(__file__).parent / "skin.dbc",
        ("Row0.T0_0", "Row0.T0_1", "Row1.T1_2", "Pages.P0", "Pages.P2", "Floats.F0", "Floats.Offset"),
    ),
}


def truth(codec, n):
    top = min(codec.full_scale, 250) + 1
    return ((np.arange(codec.size) * 31 + n * 17) % top).astype(np.uint16)


def traffic(codec, chance):
    """Messages as they arrive, a burst a frame every 10 ms, and the frame that is being sent."""
    ids = sorted(codec.ids)
    for n in range(FRAMES):
        burst = []
        for at, message in enumerate(codec.encode(truth(codec, n), n, n / 100)):
            message = message._replace(time=n / 100 + at / 10_000)
            luck = chance.random()
            if luck > 0.02:
                burst.append(message)
            if luck > 0.98 and codec.modulus:
                burst.append(message)
            if 0.96 < luck < 0.98:
                burst.append(Message(message.time, chance.choice(ids)[0], chance.randbytes(1)))
            if 0.95 < luck < 0.96:
                burst.append(Message(message.time, 0x7F0, chance.randbytes(8)))
        if codec.modulus and chance.random() < 0.3 and len(burst) > 1:
            at = chance.randrange(len(burst) - 1)
            burst[at : at + 2] = burst[at + 1], burst[at]
        yield from ((n, message) for message in burst)


@pytest.mark.parametrize("name", CODECS)
@pytest.mark.parametrize("seed", range(3))
def test_no_frame_is_wrong_and_unmarked(name, seed):
    codec = CODECS[name]
    router = Router({"it": codec})
    wrong = []
    for n, message in traffic(codec, random.Random(seed)):
        for _, frame in router.push(message):
            known = frame.flags & MISSING == 0
            right = any(np.array_equal(frame.counts[known], truth(codec, at)[known]) for at in (n, n - 1, n - 2))
            if known.all() and not right:
                wrong.append(n)
    ordered_at_once = codec.modulus or codec.ordered == codec.segments
    assert not wrong or (not ordered_at_once and max(wrong) < LEARNING)
    loss = router.assemblers["it"].loss
    sent = FRAMES * codec.segments
    assert loss.lost == pytest.approx(0.02 * sent, abs=0.015 * sent)
    assert loss.malformed == pytest.approx(0.02 * sent, abs=0.015 * sent)
