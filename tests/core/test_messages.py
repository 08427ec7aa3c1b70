"""Compiled looks at messages against plain Python."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus.codec import NO_SEQUENCE
from tactiled.core import messages

SEEDS = st.integers(0, 99)


@given(st.integers(8, 16), st.integers(1, 40), st.integers(1, 9), st.data())
def test_numbers_of_8_to_16_bits_are_unpacked(bits, taxels, rows, data):
    count = data.draw(st.integers((rows - 1) * taxels + 1, rows * taxels))
    numbers = np.random.default_rng(count).integers(0, 1 << bits, rows * taxels)
    ones = (numbers[:, None] >> np.arange(bits)) & 1
    payloads = np.packbits(ones.astype(np.uint8).reshape(rows, -1), axis=1, bitorder="little")
    out = np.empty(count, np.uint16)
    messages.unpack(payloads, bits, taxels, out)
    np.testing.assert_array_equal(out, numbers[:count])


def test_payloads_too_short_for_their_numbers_are_refused():
    for bits, taxels, count in ((7, 4, 4), (17, 4, 4), (12, 6, 6), (12, 5, 11), (12, 0, 1)):
        with pytest.raises(ValueError, match="do not hold"):
            messages.unpack(np.zeros((2, 8), np.uint8), bits, taxels, np.empty(count, np.uint16))


@given(SEEDS, st.integers(0, 30), st.integers(0, 6))
def test_a_message_is_good_whose_length_kind_and_padding_are_the_layouts(seed, count, width):
    random = np.random.default_rng(seed)
    data = random.integers(0, 2, (count, 8), np.uint8)
    lengths, kinds, expected = (random.integers(0, 2, n, np.uint8) for n in (count, count, 256))
    padding = random.integers(0, 2, (256, width), np.uint8) * random.integers(0, 2, (256, 1), np.uint8)
    sequences, segments, good = np.empty(count, int), np.empty(count, int), np.empty(count, np.uint8)
    found = messages.well_formed(data, lengths, kinds, 1, expected, padding, 2, sequences, segments, good)
    padded = (data[:, 2 : 2 + width] & padding[data[:, 1]]).any(axis=1)
    np.testing.assert_array_equal(good, (lengths == expected[data[:, 1]]) & (kinds == 1) & ~padded)
    np.testing.assert_array_equal((sequences, segments), data[:, :2].T)
    assert found == good.sum()


def fits(frame, at, segments, sequences, ordered, rank, length):
    """Whether message `at` is of the frame that has taken those before it."""
    if sequences is not None and (sequences[at] != sequences[at - 1] or sequences[at] == NO_SEQUENCE):
        return False
    if rank is not None and 2 * (rank[segments[at - 1]] - rank[segments[at]]) >= length:
        return False
    segment = int(segments[at])
    return not frame & set(range(segment, (segment // ordered + 1) * ordered))


@given(SEEDS, st.integers(1, 12), st.integers(1, 30), st.sampled_from([1, 2, 4]), st.booleans(), st.booleans())
def test_a_run_goes_on_as_long_as_messages_are_of_one_frame(seed, size, count, ordered, numbered, ranked):
    random = np.random.default_rng(seed)
    segments = (np.arange(count) + random.integers(size)) % size
    segments = np.where(random.random(count) < 0.1, random.integers(0, size, count), segments)
    sequences = np.cumsum(random.random(count) < 0.05) - 1 if numbered else None
    rank, length = (random.permutation(size), size) if ranked else (None, 0)
    times, came = random.random((2, count))
    present = (random.random(size) < 0.2).astype(np.uint8)
    at = int(random.integers(count))
    present[segments[at]] = 0
    missing = size - int(present.sum())
    frame = set(np.flatnonzero(present).tolist())
    late, highest, end = 0, max(frame, default=-1), at
    while True:
        segment = int(segments[end])
        late, highest = late + (segment < highest), max(segment, highest)
        frame.add(segment)
        end += 1
        if end == count or len(frame) == size:
            break
        if not fits(frame, end, segments, sequences, ordered, rank, length):
            break
    found = messages.run(segments, sequences, times, came, at, present, missing, ordered, rank, length)
    run = slice(at, end)
    assert found == (end, times[run].min(), times[run].max(), came[end - 1], came[run].max(), late)
    assert set(np.flatnonzero(present).tolist()) == frame


def test_a_segment_that_the_frame_does_not_have_is_refused():
    one = np.zeros(1)
    for segment in (-1, 3):
        with pytest.raises(IndexError):
            messages.run(np.array([segment]), None, one, None, 0, np.zeros(3, np.uint8), 3, 1, None, 0)
