import pytest

from tactiled.interop.zenoh.sensor import ClockOffset, Line, Parts
from tactiled.interop.zenoh.session import LOST_AFTER_S, Head, unpack

A, B = "aa" * 8, "bb" * 8


def frames(parts, numbers, kinds=("raw", "restored")):
    for number in numbers:
        for kind in kinds:
            parts.add(Head(A, number, 2), kind, b"%d" % number, b"")


def test_the_newest_complete_frame_is_handed_out_once_and_every_other_is_counted():
    parts = Parts()
    frames(parts, [7])
    head, messages = parts.pop()
    assert (head.number, messages["raw"]) == (7, (b"7", b""))
    assert parts.pop() is None
    frames(parts, [8, 9, 12])  # 8 and 9 are overtaken, 10 and 11 never came
    assert parts.pop()[0].number == 12
    assert parts.lost == 4
    frames(parts, [13], ["raw"])
    frames(parts, [14])  # 13 did not come whole
    assert (parts.pop()[0].number, parts.lost) == (14, 5)


def test_messages_that_come_again_or_late_change_nothing():
    parts = Parts()
    frames(parts, [7, 8])
    frames(parts, [8, 7])
    assert (parts.pop()[0].number, parts.lost) == (8, 1)
    assert parts.pop() is None


def test_a_frame_of_which_only_a_part_came_after_we_began_to_listen_is_not_lost():
    parts = Parts()
    frames(parts, [7], ["restored"])
    frames(parts, [8])
    assert (parts.pop()[0].number, parts.lost) == (8, 0)


def test_the_head_of_a_message_survives_its_bytes():
    head = Head(A, 2**63, 3)
    assert unpack(head.pack(b"{}")) == (head, b"{}")
    with pytest.raises(ValueError, match="3 bytes: expected 18"):
        unpack(b"abc")


def test_the_quickest_answer_tells_the_clocks_apart_until_one_is_set():
    offset = ClockOffset()
    assert offset.offset_s is None
    offset.add(100.0, 107.5, 101.0)  # 7 s ahead, give or take 0.5 s
    offset.add(110.0, 117.1, 110.2)
    offset.add(120.0, 127.9, 122.0)  # slow, and in accord: the quicker one holds
    assert (offset.offset_s, offset.error_s) == pytest.approx((7.0, 0.1))
    assert str(offset) == "7.000 s ahead (± 100.0 ms)"
    offset.add(130.0, 130.5, 131.0)  # the clock was set: the answer rules 7 s out
    assert (offset.offset_s, offset.error_s) == pytest.approx((0.0, 0.5))


def test_how_a_reader_went_is_read_off_its_token_and_its_silence():
    def line(closing=False):
        made = Line("r/palm")
        assert made.appear(A)
        made.heard_at, made.closing = 100.0, closing
        return made

    def down(each, silent=0.5):
        assert not each.vanish(A, 100.0 + silent)
        return each.down

    assert "has died" in down(line())
    assert "was stopped" in down(line(closing=True))
    late = line()
    assert "died" in down(late)
    late.close(True)  # its last message is behind the end of its token
    assert "was stopped" in late.down
    assert "nothing came for 5.0 s" in down(line(), LOST_AFTER_S + 1.5)
    own = line()
    down(own)
    own.look_at_link(False)
    assert "this server has no connection" in own.down
    own.look_at_link(True)
    assert "not come back" in own.down


def test_the_first_of_two_publishers_counts_until_it_goes_and_then_the_other():
    line = Line("r/palm")
    assert line.appear(A)
    assert not line.appear(B)
    line.parts.lost = 3
    assert line.vanish(A, 0.0)
    assert (line.session, line.down, line.lost) == (B, None, 3)
    assert not line.appear(B)  # the same token again, after the router was away
    line.vanish(B, 0.0)
    assert line.down
    assert not line.appear(B)  # its frames go on where they were
    assert line.down is None
