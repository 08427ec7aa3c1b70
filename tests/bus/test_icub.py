import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus.codecs import icub
from tactiled.bus.codecs.icub import Icub
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Message


def message(text):
    id_, data = text.split("#")
    return Message(0.0, int(id_, 16), bytes.fromhex(data))


def values(codec, *texts):
    payloads = [None] * codec.segments
    for text in texts:
        reading = codec.decode(message(text))
        payloads[reading.segment] = reading.payload
    return codec.unpack(payloads).tolist()


def test_genuine_taxels_of_a_grasp():
    codec = Icub(14, (0, 1, 2), thermal_pads=False)
    frame = ("4E0#40F3F2F2F3F3EEF6", "4E0#C0ECF4F4EFF30000", "4E1#40F4F5F5F5F5F6F4", "4E1#C0F5F5F5F5F40000",
             "4E2#40F3F3F4F3F3F3F3", "4E2#C0F4F3F3F3F30000")  # fmt: skip
    assert values(codec, *frame) == [
        243, 242, 242, 243, 243, 238, 246, 236, 244, 244, 239, 243,
        244, 245, 245, 245, 245, 246, 244, 245, 245, 245, 245, 244,
        243, 243, 244, 243, 243, 243, 243, 244, 243, 243, 243, 243,
    ]  # fmt: skip


def test_no_load_of_a_board_and_its_triangle():
    codec = Icub(13, (5,))
    assert values(codec, "4D5#40F0F0F0F0F0F0F0", "4D5#C0F0F0F0F0F00000") == [240] * 10


def test_an_older_boards_class_is_the_same_skin():
    codec = Icub(13, (5,))
    assert codec.ids == {(0x4D5, False), (0x3D5, False)}
    assert values(codec, "3D5#40F0F0F0F0F0F0F0", "3D5#C0F0F0F0F0F00000") == [240] * 10


@pytest.mark.parametrize("text", ["3D5#40F0F0F0", "3D5#40F0"])
def test_the_coarser_modes_of_older_boards_are_refused(text):
    """Three values or one a triangle: no taxels."""
    with pytest.raises(CodecError):
        Icub(13, (5,)).decode(message(text))


def test_thermal_pads_are_not_taxels():
    codec = Icub(0, (0,))
    assert values(codec, "400#4000010203040506", "400#C0070809" + "0A0B0000") == [0, 1, 2, 3, 4, 5, 7, 8, 9, 11]
    assert codec.pads == (0, 1, 2, 3, 4, 5, 7, 8, 9, 11)
    np.testing.assert_allclose(codec.positions[3], [0, 0])
    np.testing.assert_allclose(codec.positions[0], [6.43, 0])


@pytest.mark.parametrize(
    ("code", "bad"),
    [
        ("0000", ()),
        ("0010", (0,)),
        ("8000", (9,)),
        ("0400", ()),
        ("0001", tuple(range(10))),
        ("0002", tuple(range(10))),
    ],
)  # bit 4 + i: taxel i; pad 6 (bit 10) is thermal; low nibble: the triangle does not answer
def test_diagnostics_name_the_taxels_that_cannot_be_believed(code, bad):
    assert Icub(0, (0,)).decode(message(f"400#C0F0F0F0F0F0{code}")).bad == bad


def test_a_tail_without_diagnostics_is_a_tail():
    reading = Icub(0, (0,)).decode(message("400#C0F0F0F0F0F0"))
    assert (reading.segment, reading.bad) == (1, ())
    assert Icub(0, (0,)).unpack([None, reading.payload]).tolist() == [0] * 6 + [240] * 4


@pytest.mark.parametrize("text", ["400#", "400#40", "400#41F0F0F0F0F0F0F0", "400#C0F0", "401#40F0F0F0F0F0F0F0"])
def test_what_is_neither_head_nor_tail_is_refused(text):
    with pytest.raises(CodecError):
        Icub(0, (0,)).decode(message(text))


@given(
    board=st.integers(0, 15),
    triangles=st.lists(st.integers(0, 15), min_size=1, unique=True),
    thermal=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_decode_inverts_encode(board, triangles, thermal, seed):
    codec = Icub(board, tuple(triangles), thermal)
    counts = np.random.default_rng(seed).integers(0, 256, codec.size).astype(np.uint16)
    messages = codec.encode(counts, 0, 0.0)
    readings = [codec.decode(each) for each in messages]
    assert {(each.id, each.extended) for each in messages} <= codec.ids
    assert [reading.segment for reading in readings] == list(range(codec.segments))
    payloads = [reading.payload for reading in readings]
    np.testing.assert_array_equal(codec.unpack(payloads), counts)
    lost = seed % codec.segments
    counts[codec.span(lost)] = 0
    np.testing.assert_array_equal(codec.unpack([*payloads[:lost], None, *payloads[lost + 1 :]]), counts)


def test_set_up_messages():
    said = [icub.configure_board(13, 30), icub.configure_triangles(13, 0, 15), icub.start(13), icub.stop(13)]
    assert [(each.id, each.data.hex()) for each in said] == [
        (0x20D, "4d001ef0"), (0x20D, "50000f00010022"), (0x20D, "0700"), (0x20D, "0701"),
    ]  # fmt: skip


def test_a_triangle_named_twice_is_refused():
    with pytest.raises(ConfigError, match=r"\[1, 1\]"):
        Icub(0, (1, 1))
