"""The packed layout, against the guide's words, its sender and bytes worked out by hand."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus.codec import read_one
from tactiled.bus.codecs.packed import Packed
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Message

GUIDE = (Path(__file__).parents[2] / "tactiled/docs/packed.md").read_text("utf-8")
NAMES: dict = {}
exec(re.search(r"```python\n(.*?)```", GUIDE, re.DOTALL)[1], NAMES)
SENDER = NAMES["messages"]


@given(
    bits=st.integers(8, 16), fd=st.booleans(), size=st.integers(1, 300), sequence=st.integers(0, 300),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_the_layout_is_the_one_in_the_guide(bits, fd, size, sequence, seed):
    codec = Packed(size, bits, fd)
    counts = np.random.default_rng(seed).integers(0, 1 << bits, size, dtype=np.uint16)
    messages = codec.encode(counts, sequence, 0.0)
    assert len(messages) == codec.segments
    assert [message.data for message in messages] == list(SENDER(counts.tolist(), bits, fd, sequence))
    np.testing.assert_array_equal(codec.unpack([read_one(codec, each).payload for each in messages]), counts)


@pytest.mark.parametrize(
    "message",
    [
        Message(0, 0x500, b"\0"),
        Message(0, 0x500, bytes((0, 2)) + bytes(6)),  # no such segment
        Message(0, 0x500, bytes((0, 0)) + bytes(5)),  # too short
        Message(0, 0x500, bytes((0, 1)) + bytes(6)),  # the last segment is shorter
        Message(0, 0x500, bytes((0, 1)) + bytes((0, 0x10))),  # a bit set behind the last taxel
        Message(0, 0x500, bytes(8), fd=True),
    ],
)
def test_a_message_of_another_layout_is_refused(message):
    with pytest.raises(CodecError):
        read_one(Packed(5, bits=12), message)


@pytest.mark.parametrize(
    ("size", "settings", "reason"),
    [
        (1025, {}, r"1025 taxels of 12 bits need 257 messages .* at most 256: use fewer bits, or CAN FD"),
        (4, {"base_id": 0x7FF, "array_id": 1}, r"0x800 \(base_id \+ array_id\) is past 0x7ff: lower base_id"),
        (4, {"base_id": 0x1FFFFFFF, "array_id": 1, "extended": True}, "is past 0x1fffffff"),
    ],
)
def test_an_array_or_id_that_does_not_fit_is_refused(size, settings, reason):
    with pytest.raises(ConfigError, match=reason):
        Packed(size, **settings)
    Packed(1024, **settings | {"array_id": 0})
