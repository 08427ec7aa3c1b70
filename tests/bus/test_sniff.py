from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus import recording
from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.cyskin import CySkin
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed, likeliest, packed_fits
from tactiled.bus.codecs.packed import squarest as shape
from tactiled.bus.codecs.poweron import PowerOn
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.sniff import survey as recognise
from tactiled.frames import Message

RATE = 50.0


def heard(codec, count=40, rest=None, noise=2.0, rate=RATE, seed=0):
    """Frames of an array at rest with noise, a few taxels pressed."""
    rng = np.random.default_rng(seed)
    rest = min(80, codec.full_scale // 2) if rest is None else rest
    for sequence in range(count):
        counts = rest + rng.normal(0, noise, codec.size)
        counts[: max(1, codec.size // 20)] += codec.full_scale / 3
        taken = counts.clip(0, codec.full_scale).round().astype(np.uint16)
        for n, each in enumerate(codec.encode(taken, sequence, sequence / rate)):
            yield each._replace(time=sequence / rate + n * 1e-4)


def together(*streams):
    return sorted((each for stream in streams for each in stream), key=lambda each: each.time)


SKINS = {
    "packed": Packed(1024, 12, fd=True),
    "packed classic": Packed(256, 12, array_id=4),
    "icub": Icub(13, (0, 3, 5)),
    "barrett": Barrett(11),
    "cyskin": CySkin(),
    "linker": Linker("left", (1, 3)),
    "poweron": PowerOn(0x340),
    "xela": Xela(controller=2),
    "xela old": Xela("4x4-old"),
    "xela new": Xela("4x4-new"),
    "xela 4x6": Xela("4x6-old"),
    "xela single": Xela("single"),
}
NOISE = [Message(t / 97, 0x6A1, bytes((t & 0xFF, 1, 2))) for t in range(80)] + [
    Message(t / 10, 0x18FF0102, bytes(8), extended=True) for t in range(8)
]


@pytest.mark.parametrize("name", SKINS)
def test_a_skin_is_recognised_among_foreign_messages_with_its_settings_and_its_rate(name):
    codec = SKINS[name]
    told = recognise(together(heard(codec), NOISE))
    (one,) = told.senders
    assert one.match.codec == codec
    assert one.name == name.split()[0]
    assert {id_ for id_, _ in one.match.keys} == {each.id for each in heard(codec, 1)}
    assert one.rate_hz == pytest.approx(RATE, rel=0.03)
    assert one.lost == 0
    assert one.frames == 40
    assert abs(one.no_load - min(80, codec.full_scale // 2)) <= 3
    assert [each.id for each in told.unknown] == [0x6A1, 0x18FF0102]
    assert told.unknown[0].rate_hz == pytest.approx(97)


def test_everything_at_once_on_one_bus():
    some = ("packed", "packed classic", "icub", "barrett", "linker", "xela single", "poweron")
    told = recognise(together(*(heard(SKINS[name], rate=RATE + n) for n, name in enumerate(some))))
    assert sorted(each.name for each in told.senders) == sorted(each.split()[0] for each in some)
    assert told.unknown == ()


def test_two_boards_and_two_arrays_are_told_apart():
    told = recognise(
        together(
            heard(Icub(2, (0, 1))), heard(Icub(7, (15,))), heard(Packed(64, 12)), heard(Packed(64, 12, array_id=9))
        )
    )
    assert [each.match.settings.get("board") for each in told.senders if each.name == "icub"] == [2, 7]
    assert [each.match.settings.get("array_id") for each in told.senders if each.name == "packed"] == [0, 9]


def test_real_bytes_of_a_grasp():
    (one,) = recognise(recording.read(recording.path("book_1"))).senders
    assert {"name": one.name} | one.match.settings == {"name": "icub", "board": 14, "triangles": [0, 1, 2, 3, 4]}
    assert one.rate_hz == pytest.approx(50, rel=0.1)


def test_the_genuine_frames_of_a_touchdetect_are_not_a_packed_array():
    rows = ("9601E25504EFA3C7", "97ACB05505EFA3C7", "B2DCF34504EFA3C7", "9BBBB95505EFA3C7") * 3
    messages = [
        Message(t / 30 + n / 1000, 0x300 + n, bytes.fromhex(row)) for t in range(5) for n, row in enumerate(rows)
    ]
    (one,) = recognise(messages).senders
    assert {"name": one.name} | one.match.settings == {"name": "poweron", "base_id": 0x300}


def test_what_was_lost_is_said_and_a_start_within_a_frame_is_no_loss():
    messages = list(heard(Packed(256, 12)))
    del messages[1000], messages[1500], messages[:10]
    (one,) = recognise(messages).senders
    assert one.lost == 2
    (one,) = recognise(list(heard(Icub(3, (0, 1, 2))))[3:]).senders
    assert one.lost == 0


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("bits", range(8, 17))
@pytest.mark.parametrize("side", [8, 16])
def test_every_width_of_a_packed_taxel_is_found(bits, fd, side):
    codec = Packed(side * side, bits, fd=fd)
    (one,) = recognise(heard(codec, rest=(1 << bits) // 3, noise=(1 << bits) / 200)).senders
    assert (one.match.codec, one.match.shape) == (codec, (side, side))


@pytest.mark.parametrize("fd", [False, True])
def test_widths_that_lengths_or_padding_speak_against_are_not_among_the_fits(fd):
    codec = Packed(64, 12, fd=fd)
    fits = packed_fits((0x500, False), list(heard(codec)))
    bits = {each.bits for each in fits}
    assert 12 in bits
    assert 16 in bits  # fills a message to its last bit, as 8 does: only steps speak against it
    assert fd or bits.isdisjoint({10, 13})  # whose classic messages are of 7 bytes
    twelve = next(each for each in fits if each.bits == 12)
    assert twelve.min_size <= 64 <= twelve.max_size
    assert all(each.roughness > 3 * twelve.roughness for each in fits if each.bits != 12)


def test_an_array_that_says_only_zeros_gets_the_usual_width():
    messages = [each for n in range(10) for each in Packed(64, 12).encode(np.zeros(64, np.uint16), n, n / 50)]
    assert likeliest(packed_fits((0x500, False), messages)).bits == 12


def test_the_squarest_shape():
    assert shape(1015, 1025) == (32, 32)
    assert shape(61, 64) == (8, 8)
    assert shape(7, 7) == (1, 7)
    assert shape(12, 12) == (3, 4)


def test_a_counter_that_is_no_frame_of_taxels_is_left_unknown():
    rng = np.random.default_rng(0)
    speed = [Message(t / 100, 0x200, bytes((t % 256, *rng.integers(0, 256, 6).tolist()))) for t in range(200)]
    engine = [Message(t / 100, 0x2A0, bytes((0x40, *rng.integers(0, 256, 7).tolist()))) for t in range(200)]
    told = recognise(together(speed, engine))
    assert told.senders == ()
    assert {each.id for each in told.unknown} == {0x200, 0x2A0}


def test_nothing_heard_is_nothing_found():
    told = recognise([])
    assert (told.senders, told.unknown) == ((), ())


MESSAGES = st.lists(
    st.builds(
        Message,
        st.floats(0, 10),
        st.one_of(st.integers(0, 0x7FF), st.sampled_from((0x300, 0x400, 0x409, 0x405, 0x27, 0x500))),
        st.binary(max_size=8),
        st.booleans(),
    ),
    max_size=30,
)


@given(MESSAGES)
def test_any_traffic_is_either_found_or_unknown(messages):
    told = recognise(messages)
    keys = [key for each in told.senders for key in each.match.keys] + [
        (each.id, each.extended) for each in told.unknown
    ]
    assert sorted(keys) == sorted({(each.id, each.extended) for each in messages})
    assert all(a.messages >= b.messages for a, b in pairwise(told.unknown))
