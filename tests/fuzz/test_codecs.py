"""What fuzzing found worth keeping, replayed, and the same judge over Hypothesis's own bytes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.frames import MISSING
from tests.fuzz import harness


@pytest.mark.parametrize("name", harness.SKINS)
def test_every_input_of_the_corpus_gives_only_what_its_messages_carry(name):
    judged = [harness.check(name, each) for each in harness.corpus(name)]
    assert any(frames and not frames[0].flags.any() for frames, _ in judged)
    assert any((frame.flags & MISSING).any() for frames, _ in judged for frame in frames)
    assert any(loss.lost for _, loss in judged)


@pytest.mark.parametrize("name", harness.SKINS)
@settings(max_examples=200)
@given(data=st.binary(max_size=80))
def test_any_bytes_give_only_what_their_messages_carry(name, data):
    harness.check(name, data)
