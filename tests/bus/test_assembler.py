import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.bus.assembler import Assembler
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.router import Router
from tactiled.errors import ConfigError
from tactiled.frames import MISSING, Loss, Message
from tests.bus.skins import CODECS

CODEC = Packed(10, bits=12)  # three segments of 4, 4 and 2 taxels


def counts_of(sequence):
    return np.full(10, sequence % 256 + 1, np.uint16) + np.arange(10, dtype=np.uint16)


def frame_of(sequence):
    return CODEC.encode(counts_of(sequence), sequence, float(sequence))


def run(messages, codec=CODEC):
    assembler = Assembler(codec)
    frames = [frame for each in messages for _, frame in assembler.push(each)]
    return frames, assembler.loss


A, B, C = frame_of(0), frame_of(1), frame_of(2)


@pytest.mark.parametrize(
    ("messages", "sequences", "loss"),
    [
        ([*A, *B, *C], [0, 1, 2], Loss()),
        ([*A, *frame_of(4)], [0, 4], Loss(lost=9)),  # lost frames count every message they had
        ([*A, *frame_of(128)], [0, 128], Loss(lost=381)),  # half the counter is still ahead
        ([A[0], A[0], A[1], A[2], A[2], *B], [0, 1], Loss(repeated=2)),
        ([A[0], A[2], A[1], *B], [0, 1], Loss(late=1)),
        ([*(each for n in range(250, 260) for each in frame_of(n))], [*range(10)], Loss()),  # the counter wraps
        ([*(each._replace(time=0.0) for n in (5, 6, 0, 1) for each in frame_of(n))], [0, 1], Loss(late=6)),
    ],
)
def test_frames_of_which_no_message_is_lost(messages, sequences, loss):
    frames, counted = run(messages)
    assert [frame.sequence for frame in frames] == sequences
    assert counted == loss
    first = messages[0].data[0]
    for frame in frames:
        np.testing.assert_array_equal(frame.counts, counts_of((first + frame.sequence) % 256))
        assert not frame.flags.any()


def test_a_frame_carries_what_its_bus_has_counted_until_then():
    bus = {}
    assembler = Assembler(CODEC, lambda: bus)

    def loss(messages):
        return [frame.loss for each in messages for _, frame in assembler.push(each)]

    assert loss(A) == [Loss()]
    bus["errors"] = 2
    assert loss([*B, *C[:2]]) == [Loss(errors=2)]
    bus["dropped"] = 1
    assert loss(frame_of(3)) == [Loss(lost=1, incomplete=1, errors=2, dropped=1)] * 2


OTHER_A = CODEC.encode(counts_of(5), 0, 0.0)


@pytest.mark.parametrize(
    ("messages", "at", "missing", "loss"),
    [
        ([*A, B[0], B[2], *C], 1, [4, 5, 6, 7], Loss(lost=1, incomplete=1)),  # nothing is filled from before
        ([A[0], A[1], B[0], A[2], B[1], B[2]], 0, [8, 9], Loss(lost=1, late=1, incomplete=1)),
        # a segment that came twice and not the same
        ([A[0], OTHER_A[0], A[0], OTHER_A[1], A[2], *B], 0, [0, 1, 2, 3], Loss(repeated=2, incomplete=1)),
    ],
)
def test_a_lost_or_disputed_segment_is_marked_and_counted(messages, at, missing, loss):
    frames, counted = run(messages)
    assert counted == loss
    for n, frame in enumerate(frames):
        marked = missing if n == at else []
        assert np.flatnonzero(frame.flags == MISSING).tolist() == np.flatnonzero(frame.flags).tolist() == marked
        assert np.flatnonzero(frame.counts == 0).tolist() == marked


def test_a_frame_bears_the_time_of_its_first_message_and_the_skew_to_its_last():
    messages = [each._replace(time=10.0 + n / 8) for n, each in enumerate((*A, *B))]
    frames, _ = run(messages)
    assert [(frame.time, frame.skew) for frame in frames] == [(10.0, 0.25), (10.375, 0.25)]
    codec = Packed(2, 12)  # a frame of one message
    frames, loss = run([codec.encode(np.array([n, n], np.uint16), n, 0.0)[0] for n in range(3)], codec)
    assert [(frame.counts.tolist(), frame.skew) for frame in frames] == [([n, n], 0.0) for n in range(3)]
    assert loss == Loss()


def test_a_half_received_frame_is_closed_when_its_sender_falls_silent():
    assembler = Assembler(CODEC)
    assembler.push(frame_of(5)[0])
    assert assembler.flush(before=5.0) == ()
    (frame,) = assembler.flush(before=5.1)
    assert np.count_nonzero(frame.flags & MISSING) == 6
    assert assembler.flush(before=9.0) == ()


@pytest.mark.parametrize("again", [0, 7, 8])  # 7: its last message was the very frame that it begins with
def test_sender_that_restarts_after_a_pause_is_followed_at_once(again):
    before = [each._replace(time=each.time / 100) for n in range(8) for each in frame_of(n)]
    after = [each._replace(time=1.0 + each.time / 100) for n in range(again, again + 3) for each in frame_of(n)]
    frames, loss = run([*before, *after])
    assert [frame.sequence for frame in frames] == list(range(11))
    assert loss == Loss()
    np.testing.assert_array_equal(frames[8].counts, counts_of(again))


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_ages_are_of_the_arrival_and_not_of_the_buss_clock(step):
    assembler = Assembler(CODEC)
    for each in (*frame_of(100), *frame_of(101)):
        assembler.push(each._replace(time=1e9), 10.0)
    a, b = ([each._replace(time=1e9 + step) for each in frame_of(n)] for n in (0, 1))
    (((_, frame),),) = [got for each in a if (got := assembler.push(each, 10.5))]
    assert (frame.sequence, frame.time, frame.arrived) == (2, 1e9 + step, 10.5)
    assembler.push(b[0], 10.51)
    assert assembler.flush(before=10.5) == ()
    (half,) = assembler.flush(before=10.52)
    assert half.flags.any()
    assert assembler.loss == Loss(lost=2, incomplete=1)


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_step_of_the_clock_without_a_silence_is_no_restart(step):
    assembler = Assembler(CODEC)
    for at, n in enumerate((5, 6, 4, 7)):
        for each in frame_of(n):
            assembler.push(each._replace(time=1e9 + at * step), 10.0 + at / 100)
    assert assembler.loss == Loss(late=3)


def test_a_sender_that_begins_again_without_a_silence_is_followed_after_three_frames():
    frames, loss = run(each._replace(time=0.0) for n in (100, 101, *range(6)) for each in frame_of(n))
    assert [frame.counts[0] for frame in frames] == [n + 1 for n in (100, 101, 3, 4, 5)]
    assert loss == Loss(late=9)


@given(
    st.lists(st.booleans(), min_size=60, max_size=60),
    st.sampled_from([0, 1, 3, 127, 128, 200]),
    st.sampled_from([2, 10, 30]),
)
@settings(max_examples=100)
def test_two_senders_with_one_id_are_counted_and_no_frame_mixed_of_them_looks_good(turns, apart, size):
    """Each sends its own messages in order; they interleave in any way."""
    codec = Packed(size, bits=12)
    senders = [
        (each for n in range(60) for each in codec.encode(np.full(size, value, np.uint16), n + first, n / 100))
        for value, first in ((1, 0), (2, apart))
    ]
    frames, loss = run([next(senders[turn]) for turn in turns], codec)
    assert all(frame.flags.any() or len(set(frame.counts)) == 1 for frame in frames)
    if min(turns.count(True), turns.count(False)) > 2 * codec.segments:
        assert loss.lost + loss.late + loss.repeated > 0


ICUB = Icub(0, (0, 1), thermal_pads=False)
HEAD0, TAIL0, HEAD1, TAIL1 = ICUB.encode(np.arange(24, dtype=np.uint16), 0, 0.0)


@pytest.mark.parametrize(
    ("messages", "missing", "lost"),
    [
        ([HEAD0, TAIL0, HEAD1, TAIL1] * 2, [0, 0], 0),
        ([HEAD1, TAIL1, HEAD0, TAIL0] * 2, [0, 0], 0),  # triangles may come in any order
        ([HEAD0, HEAD1, TAIL1, HEAD0, TAIL0, HEAD1, TAIL1], [5, 0], 1),
        ([TAIL0, HEAD1, TAIL1, HEAD0, TAIL0, HEAD1, TAIL1], [7, 0], 1),  # a head never follows its own tail
        ([HEAD0, TAIL0, HEAD0, TAIL0, HEAD1, TAIL1], [12, 0], 2),
    ],
)
def test_a_skin_without_sequence_numbers_loses_what_the_order_proves(messages, missing, lost):
    frames, loss = run(messages, ICUB)
    assert [np.count_nonzero(frame.flags & MISSING) for frame in frames] == missing
    assert (loss.lost, loss.incomplete) == (lost, sum(map(bool, missing)))
    assert [frame.sequence for frame in frames] == [0, 1]


CYCLE = Icub(1, (0, 1, 2), thermal_pads=False)  # six messages a frame


def scans(count, order=(0, 1, 2, 3, 4, 5), codec=CYCLE):
    """Frames of one value each, sent in bursts every 10 ms."""
    for n in range(count):
        messages = codec.encode(np.full(codec.size, n, np.uint16), 0, 0.0)
        yield [messages[segment]._replace(time=n / 100 + at / 5000) for at, segment in enumerate(order)]


def mixed(frame):
    return len(set(frame.counts[frame.flags == 0])) > 1


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (4, 5, 0, 1, 2, 3), (2, 3, 0, 1, 4, 5)])
def test_the_next_frame_does_not_fill_the_gap_of_a_skin_without_sequence_numbers(order):
    bursts = list(scans(8, order))
    del bursts[3][:2]  # the triangle that comes first, head and tail
    frames, loss = run([each for burst in bursts for each in burst], CYCLE)
    assert [np.count_nonzero(frame.flags) for frame in frames] == [0, 0, 0, 12, 0, 0, 0, 0]
    assert not any(mixed(frame) for frame in frames)
    assert loss == Loss(lost=2, incomplete=1)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_skin_of_two_messages_is_not_paired_askew_after_a_loss(lost):
    codec = CODECS["dbc"]
    bursts = list(scans(12, (0, 1), codec))
    del bursts[5][lost]
    frames, _ = run([each for burst in bursts for each in burst], codec)
    assert [set(frame.counts[frame.flags == 0].tolist()) for frame in frames] == [{n} for n in range(12)]
    assert [bool(frame.flags.any()) for frame in frames] == [n == 5 for n in range(12)]


def test_a_reader_that_starts_within_a_frame_finds_where_frames_begin():
    frames, loss = run([each for burst in scans(12) for each in burst][4:], CYCLE)
    assert not any(mixed(frame) for frame in frames[5:])
    assert all(frame.skew == pytest.approx(1e-3) for frame in frames[5:])
    assert loss.incomplete <= 1


@pytest.mark.parametrize("silent", [(0, 1), (2, 3), (4, 5), (2, 3, 4, 5, 6, 7, 8, 9)])
def test_triangles_that_send_nothing_do_not_mix_frames(silent):
    codec = Icub(1, (0, 1, 2, 3, 4, 5))
    order = [segment for segment in range(12) if segment not in silent]
    bursts = list(scans(40, order, codec))
    del bursts[15][0], bursts[35][0]  # normal loss
    messages = [each for burst in bursts for each in burst]
    for began in (0, 3):
        frames, _ = run(messages[began:], codec)
        assert not any(mixed(frame) for frame in frames[12:])
        lacking = [np.count_nonzero(frame.flags & MISSING) for frame in frames[20:-1]]
        assert sorted(lacking)[:-1] == [5 * len(silent)] * (len(lacking) - 1)


@pytest.mark.parametrize("triangles", [(5, 0, 1, 2, 3, 4), (3, 0, 4, 1, 5, 2), (5, 4, 3, 2, 1, 0)])
def test_a_skin_that_changes_its_order_is_followed(triangles):
    codec = Icub(1, (0, 1, 2, 3, 4, 5))
    order = [2 * triangle + tail for triangle in triangles for tail in (0, 1)]
    late = [each._replace(time=1.0 + each.time) for burst in scans(40, order, codec) for each in burst]
    frames, _ = run([*(each for burst in scans(4, range(12), codec) for each in burst), *late], codec)
    assert not any(frame.flags.any() or mixed(frame) for frame in frames[-6:])
    assert [frame.counts[0] for frame in frames[-6:]] == list(range(34, 40))


def test_messages_go_to_the_one_sensor_of_their_id_and_others_are_counted():
    router = Router({"palm": CODEC})
    good = frame_of(0)
    for stray in (Message(0, 0x123, b"abc"), good[0]._replace(extended=True), good[0]._replace(data=b"\0\7")):
        assert router.push(stray) == ()
    frames = [frame for each in good for _, frame in router.push(each)]
    assert frames[0].loss == Loss(foreign=2, malformed=1)
    with pytest.raises(ConfigError, match="palm and tip both listen to id 0x500"):
        Router({"palm": CODEC, "tip": Packed(4)})


SKINS = {name: CODECS[name] for name in (
    "packed", "packed-fd", "icub", "barrett", "poweron", "cyskin", "linker", "xela", "dbc-mixed",
)}  # fmt: skip
FRAMES = 400
LEARNING_FRAMES = 40  # within which a skin without sequence numbers may be read askew


def truth(codec, n):
    top = min(codec.full_scale, 250) + 1
    return ((np.arange(codec.size) * 31 + n * 17) % top).astype(np.uint16)


def lossy(codec, chance):
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
                burst.append(Message(message.time, *chance.choice(ids)[:1], chance.randbytes(1), ids[0][1]))
            if 0.95 < luck < 0.96:
                burst.append(Message(message.time, 0x7F0, chance.randbytes(8)))
        if codec.modulus and chance.random() < 0.3 and len(burst) > 1:
            at = chance.randrange(len(burst) - 1)
            burst[at : at + 2] = burst[at + 1], burst[at]
        yield from ((n, message) for message in burst)


@pytest.mark.parametrize("name", SKINS)
def test_a_bus_that_loses_doubles_reorders_and_garbles_gives_no_wrong_unmarked_frame(name):
    codec = SKINS[name]
    router = Router({"it": codec})
    wrong = []
    for n, message in lossy(codec, random.Random(1)):
        for _, frame in router.push(message):
            good = frame.flags & MISSING == 0
            right = any(np.array_equal(frame.counts[good], truth(codec, at)[good]) for at in (n, n - 1, n - 2))
            if good.all() and not right:
                wrong.append(n)
    ordered_at_once = codec.modulus or codec.ordered == codec.segments
    assert not wrong or (not ordered_at_once and max(wrong) < LEARNING_FRAMES)
    loss, count = router.assemblers["it"].loss, FRAMES * codec.segments
    assert loss.lost == pytest.approx(0.02 * count, abs=0.015 * count)
    assert loss.malformed == pytest.approx(0.02 * count, abs=0.015 * count)
