"""Messages in batches, wherever these are cut, make what they make one by one."""

import random
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.bus.batch import Batch
from tactiled.bus.codec import read_one
from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.router import Router
from tactiled.frames import Message

BUSES = {
    "packed": {"palm": Packed(30, 12), "back": Packed(200, 11, fd=True, base_id=0x1000, extended=True)},
    "packed of one message": {"tip": Packed(4, 12), "palm": Packed(90, 9, base_id=0x600)},
    "icub and xela": {"skin": Icub(3, (2, 0, 5)), "uskin": Xela()},
    "alone": {"skin": Icub(3, (2, 0), thermal_pads=False)},
    "one by one": {"pad": Barrett(11), "finger": Linker("left", (2,), 0.0), "palm": Packed(10, 12)},
}
FRAMES = 24
STRANGER = 0x7F0
PAUSES_S = (0.3, 0.02, 0.02, 0.001)
CLOCK_STEPS_S = (3600.0, -3600.0, -0.01)


def sender(codec, chance):
    """What one skin sends: in its order or another, lost, doubled, altered, cut; it may begin again."""
    sequence = chance.choice((0, 120, 250))
    order = list(range(codec.segments))
    for _ in range(FRAMES):
        sequence += chance.choice((1,) * 60 + (0, 2, 130, -3, -sequence))
        counts = np.full(codec.size, chance.randrange(codec.full_scale + 1), np.uint16)
        messages = codec.encode(counts, sequence % 256, 0.0)
        if chance.random() < 0.1:
            chance.shuffle(order)
        for message in (messages[at] for at in order):
            luck, data = chance.random(), bytearray(message.data)
            data[chance.randrange(len(data))] ^= chance.randrange(1, 256)
            altered = message._replace(data=bytes(data))
            cut = message._replace(data=message.data[: chance.randrange(8)])
            faults = (
                (),
                (message, message),
                (message, altered),
                (altered,),
                (cut, cut._replace(fd=True), message),
            )
            yield from faults[int(luck * 80)] if luck * 80 < len(faults) else (message,)


def traffic(codecs, seed):
    """(message, s when it came) of all skins on a bus, whose clock may step."""
    chance = random.Random(seed)
    senders = [sender(codec, chance) for codec in codecs.values()]
    now, clock = 10.0, 1e9
    while senders:
        each = chance.choice(senders)
        for _ in range(chance.choice((1, 5, 40))):
            message = next(each, None)
            if message is None:
                senders.remove(each)
                break
            luck = chance.random()
            now += chance.choice(PAUSES_S) if luck > 0.97 else 1e-4
            clock += chance.choice(CLOCK_STEPS_S) if luck < 0.004 else 0.0
            if chance.random() < 0.02:
                yield Message(clock + now, STRANGER, b""), now
            yield message._replace(time=clock + now), now


def content(frame):
    """All that a frame holds, as values that compare bit by bit."""
    arrays = frame.counts, frame.flags, frame.shear, frame.references
    bits = [None if each is None else (each.dtype.str, each.shape, each.tobytes()) for each in arrays]
    return frame.sequence, frame.time, frame.skew, frame.arrived, astuple(frame.loss), bits


def run(codecs, messages, cuts, clock):
    """Frames and losses of a bus whose messages are taken in pieces; each third piece a silence follows."""
    router, results = Router(codecs, lambda: {"errors": 3}), []
    for first, end, silence_s in cuts:
        for at in clock(first, end):
            piece = messages[at]
            batch, now = Batch.of(each for each, _ in piece), np.array([came for _, came in piece])
            results += [(name, content(frame)) for name, frame in router.push(batch, now)]
        if silence_s:
            newest = messages[end - 1][1]
            results += [(name, content(frame)) for name, frame in router.flush(newest - silence_s)]
    return results, [astuple(each.loss) for each in router.assemblers.values()]


def at_once(first, end):
    return [slice(first, end)]


def singly(first, end):
    return [slice(at, at + 1) for at in range(first, end)]


@pytest.mark.parametrize("bus", BUSES)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from((7, 60, 10_000)))
@settings(max_examples=15, deadline=None)
def test_a_batch_makes_what_its_messages_make_one_by_one(bus, seed, size):
    codecs, chance = BUSES[bus], random.Random(seed)
    messages = list(traffic(codecs, seed))
    cuts, first = [], 0
    while first < len(messages):
        end = min(first + chance.randint(1, size), len(messages))
        cuts.append((first, end, chance.choice((0.0, 0.0, 0.05))))
        first = end
    frames, losses = run(codecs, messages, cuts, at_once)
    assert (frames, losses) == run(codecs, messages, cuts, singly)
    assert frames


@pytest.mark.parametrize("codec", [codec for bus in BUSES.values() for codec in bus.values()])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_a_batch_is_its_messages(codec, seed):
    messages = [each for each, _ in traffic({"it": codec}, seed)]
    batch = Batch.of(messages)
    assert list(batch) == messages
    assert list(batch[5:9]) == messages[5:9]
    readings = codec.readings(batch)
    owned = [(each.id, each.extended) in codec.ids for each in messages]
    for at in np.flatnonzero(readings.good & owned).tolist():
        one = read_one(codec, messages[at])
        assert (one.time, one.segment, one.bad) == (
            messages[at].time, readings.segments[at], readings.bad.get(at, ())
        )  # fmt: skip
        assert one.payload == bytes(readings.payloads[at])
