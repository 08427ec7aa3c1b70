import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus.codecs.packed import Packed
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Message

GUIDE = (Path(__file__).parents[2] / "tactiled/docs/packed.md").read_text("utf-8")
NAMES: dict = {}
exec(re.search(r"```python\n(.*?)```", GUIDE, re.DOTALL)[1], NAMES)
SENDER = NAMES["messages"]


@given(bits=st.integers(8, 16), fd=st.booleans(), size=st.integers(1, 400), seed=st.integers(0, 2**32 - 1))
def test_decode_inverts_encode_over_the_whole_range(bits, fd, size, seed):
    codec = Packed(size, bits, fd)
    counts = np.random.default_rng(seed).integers(0, 1 << bits, size, dtype=np.uint16)
    readings = [codec.decode(message) for message in codec.encode(counts, 300, 1.5)]
    for segment, reading in enumerate(readings):
        assert (reading.segment, reading.sequence, reading.time) == (segment, 300 % 256, 1.5)
    payloads = [reading.payload for reading in readings]
    np.testing.assert_array_equal(codec.unpack(payloads), counts)
    lost = seed % codec.segments
    counts[codec.span(lost)] = 0
    np.testing.assert_array_equal(codec.unpack([*payloads[:lost], None, *payloads[lost + 1 :]]), counts)


@given(bits=st.integers(8, 16), fd=st.booleans(), size=st.integers(1, 200), seed=st.integers(0, 2**32 - 1))
def test_the_payload_is_one_little_endian_integer_of_whole_taxels(bits, fd, size, seed):
    """The guide's words, done with Python's own integers."""
    codec = Packed(size, bits, fd)
    counts = np.random.default_rng(seed).integers(0, 1 << bits, size, dtype=np.uint16)
    capacity = (496 if fd else 48) // bits
    parts = [counts[at : at + capacity].tolist() for at in range(0, size, capacity)]
    messages = codec.encode(counts, 9, 0.0)
    assert len(messages) == codec.segments == len(parts)
    for segment, (message, part) in enumerate(zip(messages, parts, strict=True)):
        needs = 2 + math.ceil(len(part) * bits / 8)
        assert len(message.data) == min(n for n in (*range(9), 12, 16, 20, 24, 32, 48, 64) if n >= needs)
        assert message.data[:2] == bytes((9, segment))
        value = sum(taxel << (n * bits) for n, taxel in enumerate(part))
        assert int.from_bytes(message.data[2:], "little") == value


@given(bits=st.integers(8, 16), fd=st.booleans(), size=st.integers(1, 400), sequence=st.integers(0, 300))
def test_the_sender_in_the_guide_sends_what_the_codec_does(bits, fd, size, sequence):
    counts = np.random.default_rng(size).integers(0, 1 << bits, size, dtype=np.uint16)
    sent = [message.data for message in Packed(size, bits, fd).encode(counts, sequence, 0.0)]
    assert list(SENDER(counts.tolist(), bits, fd, sequence)) == sent


def test_golden_bytes_of_a_classic_message():
    codec = Packed(6, bits=12)
    first, second = codec.encode(np.array([0xABC, 0x123, 0xFFF, 1, 2, 3], np.uint16), 7, 0.0)
    # little-endian bit order: taxel 0 is the low 12 bits of the payload
    assert first.data.hex() == "0700" + "bc3a12ff1f00"
    assert second.data.hex() == "0701" + "023000"
    assert (first.id, first.extended, first.fd) == (0x500, False, False)
    assert int.from_bytes(first.data[2:], "little") == 0xABC | 0x123 << 12 | 0xFFF << 24 | 1 << 36


def test_golden_bytes_of_a_padded_fd_message():
    codec = Packed(8, bits=10, fd=True, array_id=3)
    (message,) = codec.encode(np.arange(8, dtype=np.uint16), 255, 0.0)
    assert (len(message.data), message.id, message.fd) == (12, 0x503, True)
    assert message.data[:2].hex() == "ff00"
    assert int.from_bytes(message.data[2:], "little") == sum(n << (10 * n) for n in range(8))


@pytest.mark.parametrize(
    ("size", "bits", "fd", "taxels", "segments"),
    [(1024, 12, False, 4, 256), (1024, 12, True, 41, 25), (100, 8, False, 6, 17), (100, 16, False, 3, 34),
     (1024, 16, True, 31, 34), (1, 8, False, 6, 1)],
)  # fmt: skip
def test_segments_are_as_the_readme_says(size, bits, fd, taxels, segments):
    codec = Packed(size, bits, fd)
    assert (codec.taxels, codec.segments) == (taxels, segments)


@pytest.mark.parametrize(
    "message",
    [
        Message(0, 0x500, b""),
        Message(0, 0x500, b"\0"),
        Message(0, 0x500, bytes((0, 2)) + bytes(6)),  # no such segment
        Message(0, 0x500, bytes((0, 0)) + bytes(5)),  # too short
        Message(0, 0x500, bytes((0, 1)) + bytes(6)),  # the last segment is shorter
        Message(0, 0x500, bytes((0, 1)) + bytes((0, 0x10))),  # a bit set behind the last taxel
        Message(0, 0x500, bytes(8), fd=True),
    ],
)
def test_a_message_that_is_not_the_layouts_is_refused(message):
    with pytest.raises(CodecError):
        Packed(5, bits=12).decode(message)


def test_an_array_larger_than_the_layout_carries_is_refused_with_the_limit():
    with pytest.raises(ConfigError, match=r"1025 taxels of 12 bits need 257 messages .* at most 256"):
        Packed(1025, 12)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"bits": 7}, "codec.bits = 7"),
        ({"bits": 17}, "codec.bits = 17"),
        ({"base_id": 0x7FF, "array_id": 1}, "0x800"),
    ],
)
def test_a_setting_that_cannot_be_is_refused_by_name(settings, says):
    with pytest.raises(ConfigError, match=says):
        Packed(4, **settings)


def test_a_count_of_too_many_bits_is_not_cut_off_in_silence():
    with pytest.raises(CodecError, match="4096"):
        Packed(2, 12).encode(np.array([0, 4096], np.uint16), 0, 0.0)
