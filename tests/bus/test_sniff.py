from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus import recording
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed, likeliest, packed_fits, squarest
from tactiled.bus.sniff import survey
from tactiled.frames import Message
from tests.bus.skins import CODECS, traffic

CLASSIC = Packed(256, 12, array_id=4)
SKINS = {name: codec for name, codec in CODECS.items() if not name.startswith(("packed", "dbc", "icub-"))}
SKINS |= {"packed": Packed(1024, 12, fd=True), "packed-classic": CLASSIC}
SKINS |= {"icub-fingertip": Icub(14, (0, 1))}  # types of triangles are not told apart
STRANGERS = [Message(t / 97, 0x6A1, bytes((t & 0xFF, 1, 2))) for t in range(80)] + [
    Message(t / 10, 0x18FF0102, bytes(8), extended=True) for t in range(8)
]


def together(*streams):
    return sorted((each for stream in streams for each in stream), key=lambda each: each.time)


def as_recognised(codec):
    """A codec as a bus shows it: rows and columns in their usual order, the rest in the order of ids."""
    order = {"rows": True, "columns": True, "triangles": False, "fingers": False}
    sorts = {
        key: tuple(sorted(getattr(codec, key), reverse=down)) for key, down in order.items() if hasattr(codec, key)
    }
    return type(codec)(**{key: getattr(codec, key) for key in codec.__dataclass_fields__} | sorts)


@pytest.mark.parametrize("name", SKINS)
def test_a_skin_is_recognised_among_foreign_messages_with_its_settings_and_its_rate(name):
    codec = as_recognised(SKINS[name])
    result = survey(together(traffic(codec), STRANGERS))
    (one,) = result.senders
    assert (one.match.codec, one.name) == (codec, name.split("-")[0])
    assert {id_ for id_, _ in one.match.keys} == {each.id for each in traffic(codec, 1)}
    assert one.rate_hz == pytest.approx(50.0, rel=0.03)
    assert (one.lost, one.frames) == (0, 40)
    assert abs(one.no_load - min(80, codec.full_scale // 2)) <= 3
    assert [each.id for each in result.unknown] == [0x6A1, 0x18FF0102]
    assert result.unknown[0].rate_hz == pytest.approx(97)


TOUCH_DETECT = ("9601E25504EFA3C7", "97ACB05505EFA3C7", "B2DCF34504EFA3C7", "9BBBB95505EFA3C7") * 3


def test_real_bytes_are_recognised_on_one_bus_with_others():
    grasp = list(recording.read(recording.path("book_1")))
    touch_detect = [
        Message(grasp[0].time + t / 30 + n / 1000, 0x310 + n, bytes.fromhex(row))
        for t in range(5)
        for n, row in enumerate(TOUCH_DETECT)
    ]
    others = [SKINS[each] for each in ("packed", "packed-classic", "barrett", "linker", "xela-single")]
    others += [Icub(2, (0, 1)), Icub(7, (15,)), Packed(64, 12, array_id=9)]
    streams = [traffic(codec, rate_hz=50.0 + n) for n, codec in enumerate(others)]
    result = survey(together(grasp, touch_detect, *streams))
    assert {each.match.codec for each in result.senders} >= set(others)
    assert result.unknown == ()
    real = {each.name: each for each in result.senders if each.match.codec not in others}
    assert real["icub"].match.settings == {"board": 14, "triangles": [0, 1, 2, 3, 4]}
    assert real["icub"].rate_hz == pytest.approx(50, rel=0.1)
    assert real["poweron"].match.settings == {"base_id": 0x310}
    assert len(real) == 2


def test_lost_messages_are_counted_and_a_start_within_a_frame_is_no_loss():
    messages = list(traffic(CLASSIC))
    del messages[1000], messages[1500], messages[:10]
    (one,) = survey(messages).senders
    assert one.lost == 2
    (one,) = survey(list(traffic(Icub(3, (0, 1, 2))))[3:]).senders
    assert one.lost == 0


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("bits", range(8, 17))
@pytest.mark.parametrize("side", [8, 16])
def test_every_width_of_a_packed_taxel_is_found(bits, fd, side):
    codec = Packed(side * side, bits, fd=fd)
    (one,) = survey(traffic(codec, rest=(1 << bits) // 3, noise=(1 << bits) / 200)).senders
    assert (one.match.codec, one.match.shape) == (codec, (side, side))


@pytest.mark.parametrize("fd", [False, True])
def test_widths_that_contradict_lengths_or_padding_are_left_out(fd):
    fits = {each.bits: each for each in packed_fits((0x500, False), list(traffic(Packed(64, 12, fd=fd))))}
    assert {12, 16} <= {*fits}  # 16 fills a message to its last bit, as 8 does: only steps speak against it
    assert fd or {*fits}.isdisjoint({10, 13})  # whose classic messages are of 7 bytes
    twelve = fits.pop(12)
    assert twelve.min_size <= 64 <= twelve.max_size
    assert all(each.roughness > 3 * twelve.roughness for each in fits.values())
    zeros = [each for n in range(10) for each in Packed(64, fd=fd).encode(np.zeros(64, np.uint16), n, n / 50)]
    assert likeliest(packed_fits((0x500, False), zeros)).bits == 12  # the usual one
    shapes = [squarest(1015, 1025), squarest(61, 64), squarest(7, 7), squarest(12, 12)]
    assert shapes == [(32, 32), (8, 8), (1, 7), (3, 4)]


def test_a_counter_without_segments_is_no_packed_array():
    rng = np.random.default_rng(0)
    speed = [Message(t / 100, 0x200, bytes((t % 256, *rng.integers(0, 256, 6).tolist()))) for t in range(200)]
    engine = [Message(t / 100, 0x2A0, bytes((0x40, *rng.integers(0, 256, 7).tolist()))) for t in range(200)]
    result = survey(together(speed, engine))
    assert result.senders == ()
    assert {each.id for each in result.unknown} == {0x200, 0x2A0}


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
def test_any_traffic_is_either_recognised_or_unknown(messages):
    result = survey(messages)
    keys = [key for each in result.senders for key in each.match.keys]
    keys += [(each.id, each.extended) for each in result.unknown]
    assert sorted(keys) == sorted({(each.id, each.extended) for each in messages})
    assert all(a.messages >= b.messages for a, b in pairwise(result.unknown))
