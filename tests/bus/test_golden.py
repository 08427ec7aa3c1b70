"""Bytes that real hardware sent, or that follow from a published layout, and what they stand for."""

import numpy as np
import pytest

from tactiled.bus.assembler import Assembler
from tactiled.bus.codec import read_one
from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.cyskin import CySkin
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.linker_l30 import LinkerL30
from tactiled.bus.codecs.omnihand import OmniHand
from tactiled.bus.codecs.poweron import PowerOn
from tactiled.bus.codecs.xela import Xela
from tactiled.errors import CodecError
from tactiled.frames import MISSING, Message
from tests.bus.skins import CODECS, counts_of, message, payloads_of

# As a module of two SDAs with eight taxels each sent them.
XELA_FRAME = (
    "141#9340983F0C915114", "071#933DB83FFA8E3717", "031#933DEA4178901F0F", "021#933EFC41AC8EDA0E",
    "051#933FFE403B8B5415", "131#933DD140288B230F", "061#833F3D40408CC316",
)  # fmt: skip


def test_genuine_xela_axes_and_shear():
    codec = CODECS["xela-2x8"]
    payloads = payloads_of(codec, map(message, XELA_FRAME))
    axes = codec.axes(payloads).reshape(2, 8, 3)
    assert axes[1, 4].tolist() == [0x4098, 0x3F0C, 0x9151]
    assert axes[0, 7].tolist() == [0x3DB8, 0x3FFA, 0x8E37]
    assert axes[0, 6].tolist() == [0x3F3D, 0x4040, 0x8CC3]
    z = codec.unpack(payloads).reshape(2, 8).tolist()
    assert z == [[0, 0, 0x8EDA, 0x901F, 0, 0x8B54, 0x8CC3, 0x8E37], [0, 0, 0, 0x8B23, 0x9151, 0, 0, 0]]
    assembler = Assembler(codec)
    for text in XELA_FRAME:
        assembler.push(message(text))
    (frame,) = assembler.flush(1.0)
    shear = frame.shear.reshape(2, 2, 8)
    assert shear[:, 1, 4].tolist() == [0x4098 - 0x4000, 0x3F0C - 0x4000]
    assert shear[:, 0, 7].tolist() == [0x3DB8 - 0x4000, 0x3FFA - 0x4000]
    np.testing.assert_array_equal(np.isnan(frame.shear), [frame.flags == MISSING] * 2)


@pytest.mark.parametrize(
    ("codec", "id_", "taxel"),
    [
        (Xela(), "151", 18),  # the first SDA is at the bottom, taxel 5 at the left
        (Xela("4x4-old"), "123", 11),
        (Xela("4x4-new"), "21A", 14),
        (Xela("4x6-old"), "135", 23),
        (Xela("single"), "71F", 15),
    ],
)
def test_xelas_ids(codec, id_, taxel):
    assert read_one(codec, message(f"{id_}#9340003F0C915114")).segment == taxel


@pytest.mark.parametrize(
    ("codec", "model"),
    [
        (Xela(), "uSPa46"),
        (Xela(rows=(3, 2, 1, 0), columns=(3, 2, 1, 0)), "uSPa44"),
        (Xela(rows=(0, 1), columns=tuple(range(8))), "XR1944"),
        (Xela(rows=(0, 1), columns=(0, 1, 2)), "unknown"),
        (Xela("4x4-new"), "XR1944"),
        (Xela("4x6-old"), "XR1946"),
        (Xela("single"), "unknown"),
        (Xela("single", model="XR1911"), "XR1911"),
        (Xela(model="XR1946"), "XR1946"),
    ],
)
def test_xelas_model_follows_from_ids_and_size_unless_it_is_configured(codec, model):
    assert codec.model_name == model


@pytest.mark.parametrize(
    ("codec", "texts", "counts"),
    [
        (
            PowerOn(),  # genuine
            ("300#9601E25504EFA3C7", "301#97ACB05505EFA3C7", "302#B2DCF34504EFA3C7", "303#9BBBB95505EFA3C7",
             "304#AFF2E94504EFA3C7", "305#A4BCBE5505EFA3C7"),
            [0x596, 0x501, 0x4E2, 0x597, 0x5AC, 0x5B0, 0x5B2, 0x4DC, 0x4F3, 0x59B, 0x5BB, 0x5B9,
             0x5AF, 0x4F2, 0x4E9, 0x5A4, 0x5BC, 0x5BE, *[0] * 18],
        ),
        (
            Icub(14, (0, 1, 2), thermal_pads=False),  # of a grasp
            ("4E0#40F3F2F2F3F3EEF6", "4E0#C0ECF4F4EFF30000", "4E1#40F4F5F5F5F5F6F4", "4E1#C0F5F5F5F5F40000",
             "4E2#40F3F3F4F3F3F3F3", "4E2#C0F4F3F3F3F30000"),
            [243, 242, 242, 243, 243, 238, 246, 236, 244, 244, 239, 243,
             244, 245, 245, 245, 245, 246, 244, 245, 245, 245, 245, 244,
             243, 243, 244, 243, 243, 243, 243, 244, 243, 243, 243, 243],
        ),
        (Icub(13, (5,)), ("4D5#40F0F0F0F0F0F0F0", "4D5#C0F0F0F0F0F00000"), [240] * 10),
        (Icub(13, (5,)), ("3D5#40F0F0F0F0F0F0F0", "3D5#C0F0F0F0F0F0"), [240] * 10),  # an older board's class
        (Icub(0, (0,)), ("400#4000010203040506", "400#C00708090A0B0000"), [0, 1, 2, 3, 4, 5, 7, 8, 9, 11]),
        (Icub(0, (0,)), ("400#C0F0F0F0F0F0",), [0] * 6 + [240] * 4),  # a tail without diagnostics
        (Icub(14, (8,), skin_type=1), ("4E8#4000010203040506", "4E8#C00708090A0B0000"), [*range(11)]),
        (
            Icub(2, (4, 5), skin_type=3),  # a fingertip and a triangle of the palm
            ("424#4000010203040506", "424#C00708090A0B0000", "425#4000010203040506", "425#C00708090A0B0000"),
            [*range(11), 0, 1, 2, 3, 4, 5, 7, 8, 9, 11],
        ),
        (
            Barrett(11),  # derived: segment[4] t0[12] ... t4[12]; there is no 25th taxel
            ("569#2ABC123FFF001800", "569#4111222333444FFF"),
            [0] * 10 + [0xABC, 0x123, 0xFFF, 0x001, 0x800] + [0] * 5 + [0x111, 0x222, 0x333, 0x444],
        ),
        (
            CySkin(),  # derived: value n, little-endian, is taxel ORDER[n]
            ("405#0100020003000400", "40B#3412000000000080"),
            [0, 0x8000, 0x1234, 0, 0, 0, 0, 0, 0, 0, 0, 1, 4, 0, 3, 2],
        ),
        (Linker("right", (2, 1)), ("027#B130000102030405",), [0] * 90 + [0, 1, 2, 3, 4, 5] + [0] * 48),
        (Linker("right", (1,), layout="10x4"), ("027#B13001020304",), [0] * 12 + [1, 2, 3, 4] + [0] * 24),
        (  # a row ends in the first message; the second is a finger's last, the third its forces
            Linker("right", (2,), layout="g20-5"),
            ("027#B200050102030405", "027#B2160701FF", "027#B2FF270251052004"),
            [0] * 5 + [1, 2, 3, 4, 5] + [0] * 195 + [1, 0xFF],
        ),
        (Linker("left", (6,), layout="g20-5"), ("028#B61B0F0102030405",), [0] * 555 + [1, 2, 3, 4, 5]),
        (Linker("left", (6,), layout="g20-7"), ("028#B60D0C01020304",), [0] * 220 + [1, 2, 3, 4]),
    ],
)  # fmt: skip
def test_counts_of_golden_messages(codec, texts, counts):
    assert counts_of(codec, *texts) == counts


def test_icubs_thermal_pads_are_references_and_not_taxels():
    assembler = Assembler(Icub(0, (0, 1)))
    for text in ("400#4000010203040506", "400#C00708090A0B0000", "401#40F0F1F2F3F4F5F6"):  # no tail of triangle 1
        assembler.push(message(text))
    (frame,) = assembler.flush(1.0)
    np.testing.assert_array_equal(frame.references, [6, 10, 0xF6, np.nan])
    assert Icub(0, (0, 1), thermal_pads=False).references([None] * 4) is None


def test_thermal_pads_follow_the_skin_type():
    texts = ("424#4000010203040506", "424#C00708090A0B8000", "425#4000010203040506")  # pad 11 of the first is bad
    codec = Icub(2, (4, 5), skin_type=3)
    np.testing.assert_array_equal(codec.references(payloads_of(codec, map(message, texts))), [np.nan, 6, np.nan])
    assert read_one(codec, message("425#C00708090A0B8000")).bad == (20,)
    assert codec.positions.shape == (21, 2)


@pytest.mark.parametrize(
    ("code", "references"),
    [("8000", [6, 10]), ("0400", [np.nan, 10]), ("4000", [6, np.nan]), ("0001", [np.nan, np.nan])],
)
def test_a_thermal_pad_that_the_board_calls_bad_is_no_reference(code, references):
    assembler = Assembler(Icub(0, (0,)))
    assembler.push(message("400#4000010203040506"))
    ((_, frame),) = assembler.push(message(f"400#C00708090A0B{code}"))
    np.testing.assert_array_equal(frame.references, references)


@pytest.mark.parametrize(
    ("code", "bad"),
    [
        ("0000", ()),
        ("0010", (0,)),
        ("8000", (9,)),
        ("0400", ()),  # pad 6 is thermal
        ("0001", tuple(range(10))),  # the triangle does not answer
        ("0002", tuple(range(10))),
    ],
)
def test_icubs_diagnostics_name_faulty_taxels(code, bad):
    assert read_one(Icub(0, (0,)), message(f"400#C0F0F0F0F0F0{code}")).bad == bad
    assert read_one(Icub(0, (1, 0)), message(f"400#C0F0F0F0F0F0{code}")).bad == tuple(10 + each for each in bad)


@pytest.mark.parametrize(
    ("codec", "text"),
    [
        (Icub(0, (0,)), "400#41F0F0F0F0F0F0F0"),
        (Icub(0, (0,)), "400#C0F0"),
        (Icub(0, (0,)), "401#40F0F0F0F0F0F0F0"),  # another triangle
        (Icub(13, (5,)), "3D5#40F0F0F0"),  # the coarser modes of older boards: three values a triangle
        (Icub(13, (5,)), "3D5#40F0"),  # or one
        (Barrett(11), "569#5ABC123FFF001800"),  # a sixth segment
        (Linker("right", (1,)), "027#B230000102030405"),  # another finger
        (Linker("right", (1,)), "027#B1C0000102030405"),  # a thirteenth row
        (Linker("right", (1,)), "027#B131000102030405"),
        (Linker("right", (1,), layout="10x4"), "027#B1A001020304"),
        (Linker("right", (1,), layout="g20-5"), "027#B100090102030405"),  # a tenth column
        (Linker("right", (1,), layout="g20-5"), "027#B100010102030405"),  # begins between two messages
        (Linker("right", (1,), layout="g20-5"), "027#B11607010203"),  # three taxels where two are left
        (Linker("right", (1,), layout="g20-5"), "027#B600000102030405"),  # the palm
        (PowerOn(), "30C#9601E25504EFA3C7"),
        (CySkin(), "406#0100020003000400"),
    ],
)
def test_another_message_is_refused(codec, text):
    with pytest.raises(CodecError):
        read_one(codec, message(text))


@pytest.mark.parametrize(("status", "bad"), [(1, ()), (0, tuple(range(72, 144)))])
def test_an_o20s_finger_is_a_status_and_taxels_in_two_messages(status, bad):
    codec = Linker("right", (1, 2), layout="o20")
    first = Message(0.0, 0x216000, bytes((status, *range(1, 64))), True, True)
    second = Message(0.0, 0x218000, bytes((*range(64, 73), 0, 0, 0)), True, True)
    assert read_one(codec, first).bad == bad
    assert codec.unpack(payloads_of(codec, (first, second))).tolist() == [0] * 72 + [*range(1, 73)]
    for each in (second._replace(data=second.data[:8]), first._replace(id=0x21A000), first._replace(fd=False)):
        with pytest.raises(CodecError):
            read_one(codec, each)


@pytest.mark.parametrize("head", ["3d1001", "3c1000", "3d2000"])
def test_an_l30s_finger_is_61_taxels_and_11_with_the_hand_as_their_source(head):
    """As get_finger_touch of linkerhand-l30-sdk sends and reads it."""
    codec = LinkerL30(1, (1,))
    (request,) = [each.message for each in codec.polling.polls]
    assert (request.id, request.data, request.extended, request.fd) == (0x402100, b"\0\0", True, True)
    first = Message(0.0, 0x402008, bytes.fromhex("3d1000") + bytes(range(61)), True, True)
    second = Message(0.0, 0x402008, bytes.fromhex("0b1100") + bytes(range(61, 72)) + b"\0\0", True, True)
    assert codec.unpack(payloads_of(codec, [second, first])).tolist() == [*range(72)]
    assert codec.encode(np.arange(72), 0, 0.0) == [first, second]
    with pytest.raises(CodecError, match=f"begins {head[:2]} {head[2:4]} {head[4:]}"):  # a status, or no such part
        read_one(codec, first._replace(data=bytes.fromhex(head) + bytes(61)))


@pytest.mark.parametrize(
    ("hand", "finger"),
    [
        ("right", [14, 15, 12, 13, 10, 11, 8, 9, 6, 7, 4, 5, 2, 3, 0, 1]),  # tactile_sensor_array.jpg of its SDK
        ("left", [15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0]),
    ],
)
def test_an_omnihands_finger_is_8_x_2_and_mirrored_on_the_left(hand, finger):
    codec = OmniHand(1, hand, parts=(1, 7))
    thumb = Message(0.0, 0x1050101, bytes(range(16)), True, True)
    back = Message(0.0, 0x7050101, bytes(range(100, 132)), True, True)  # padded to a length of CAN FD
    assert codec.unpack(payloads_of(codec, (thumb, back))).tolist() == [*finger, *range(100, 125)]
    for each in (thumb._replace(data=thumb.data[:12]), back._replace(data=back.data[:24])):
        with pytest.raises(CodecError):
            read_one(codec, each)


def test_icubs_taxels_have_positions():
    positions = Icub(0, (0, 7)).positions
    assert positions.shape == (20, 2)
    np.testing.assert_allclose(positions[[0, 3, 9]], [[6.43, 0], [0, 0], [3.2155, 5.57075]], atol=1e-9)
    np.testing.assert_allclose(positions[10:] - positions[:10], [[25.0, 0.0]] * 10)
