"""SocketCAN itself, with can-utils as independent peers."""

import gc
import shutil
import socket
import subprocess
import time
from threading import Event

import numpy as np
import pytest

from tactiled.bus import recording
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.reader import BUFFER_BYTES, only, open_bus
from tactiled.bus.router import Router
from tactiled.errors import BusError
from tactiled.frames import Message
from tests.study.bus import live

SMALL = Packed(10, 12)  # three messages a frame


def counts_of(codec, sequence):
    return (np.arange(codec.size) * 7 + sequence).astype(np.uint16) % 4096


def frames_in(reader, router, quiet=1.0):
    """Every frame until the bus is quiet, as (sensor, frame)."""
    frames = []
    while (message := reader.receive(quiet)) is not None:
        frames += router.push(message)
    return frames


@pytest.mark.parametrize("fd", [False, True])
def test_frames_arrive_whole_with_the_kernels_time(bus, fd):
    codec = Packed(100, 12, fd)
    sender, reader = bus(fd), bus(fd)
    began = time.time()
    for sequence in range(20):
        for message in codec.encode(counts_of(codec, sequence), sequence, 0.0):
            sender.send(message)
    frames = frames_in(reader, Router({"it": codec}))
    assert [frame.sequence for _, frame in frames] == list(range(20))
    for _, frame in frames:
        np.testing.assert_array_equal(frame.counts, counts_of(codec, frame.sequence))
        assert began - 0.1 <= frame.time <= time.time()
        assert 0 <= frame.skew < 5


def test_extended_ids_and_every_length_of_fd(bus):
    sender, reader = bus(fd=True), bus(fd=True)
    for length in (0, 1, 8, 12, 16, 20, 24, 32, 48, 64):
        sent = Message(0.0, 0x18FF0000 + length, bytes(range(length)), extended=True, fd=True)
        sender.send(sent)
        assert reader.receive(1.0)._replace(time=0.0) == sent


def test_a_classic_interface_refuses_fd_in_one_line(bus):
    with pytest.raises(BusError, match=r"^bus socketcan vcan0: ") as caught:
        bus().send(Message(0.0, 0x500, bytes(64), fd=True))
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interface_that_is_not_there_is_named():
    with pytest.raises(BusError, match=r"gone0: .*no such interface: see `ip link show type can`"):
        open_bus(interface="socketcan", channel="gone0")
    gc.collect()  # python-can leaves a socket that it could not bind to the collector, which warns


def test_noise_of_other_ids_is_counted_and_harms_nothing(bus, run):
    sender, reader = bus(), bus()
    noise = run("cangen", "vcan0", "-I", "123", "-g", "1", "-n", "300")
    for sequence in range(100):
        for message in SMALL.encode(counts_of(SMALL, sequence), sequence, 0.0):
            sender.send(message)
        time.sleep(0.003)
    assert noise.wait(30) == 0
    router = Router({"it": SMALL})
    frames = frames_in(reader, router)
    assert len(frames) == 100
    loss = router.assemblers["it"].loss
    assert (loss.foreign, loss.lost, loss.malformed, loss.late) == (300, 0, 0, 0)


def test_filters_keep_other_ids_in_the_kernel(bus):
    reader = bus(can_filters=[{"can_id": 0x500, "can_mask": 0x7FF, "extended": False}])
    sender = bus()
    for id_, extended in ((0x123, False), (0x500, True), (0x500, False), (0x501, False)):
        sender.send(Message(0.0, id_, b"\1", extended))
    got = reader.receive(1.0)
    assert (got.id, got.extended) == (0x500, False)
    assert reader.receive(0.3) is None


@pytest.mark.parametrize("fd", [False, True])
def test_what_candump_logs_is_what_was_decoded(bus, tmp_path, fd):
    codec = Packed(100, 12, fd)
    sender, reader = bus(fd), bus(fd)
    log = tmp_path / "candump.log"
    with log.open("w") as out:
        dump = subprocess.Popen(["candump", "-L", "vcan1" if fd else "vcan0"], stdout=out)
        try:
            time.sleep(1.0)
            for sequence in range(10):
                for message in codec.encode(counts_of(codec, sequence), sequence, 0.0):
                    sender.send(message)
            live = frames_in(reader, Router({"it": codec}))
            time.sleep(0.5)
        finally:
            dump.terminate()
            dump.wait(10)
    router = Router({"it": codec})
    logged = [frame for message in recording.read(log) for frame in router.push(message)]
    assert len(live) == len(logged) == 10
    for (_, ours), (_, theirs) in zip(live, logged, strict=True):
        np.testing.assert_array_equal(ours.counts, theirs.counts)
        assert ours.time == pytest.approx(theirs.time, abs=1e-3)


def test_what_canplayer_plays_is_the_recording(bus, run):
    codec = Icub(14, (0, 1, 2, 3, 4), thermal_pads=False)
    reader = bus()
    path = recording.path("book_1")
    assert run("canplayer", "vcan0=can0", "-I", path).wait(30) == 0
    played = frames_in(reader, Router({"it": codec}))
    router = Router({"it": codec})
    expected = [frame for message in recording.read(path) for frame in router.push(message)]
    assert len(played) == len(expected) == 15
    for (_, ours), (_, theirs) in zip(played, expected, strict=True):
        np.testing.assert_array_equal(ours.counts, theirs.counts)


def test_what_is_replayed_is_what_candump_sees(bus, tmp_path):
    log = tmp_path / "candump.log"
    path = recording.path("book_2")
    with log.open("w") as out:
        dump = subprocess.Popen(["candump", "-L", "vcan0"], stdout=out)
        time.sleep(1.0)
        assert recording.play(path, bus().send, Event()) == 140
        time.sleep(1.0)
        dump.terminate()
        dump.wait(10)
    assert [each.data for each in recording.read(log)] == [each.data for each in recording.read(path)]


def test_four_arrays_on_one_bus(bus):
    codecs = {f"array{n}": Packed(20, 12, array_id=n) for n in range(4)}
    sender, reader = bus(), bus()
    for sequence in range(30):
        rows = [codec.encode(counts_of(codec, 50 * n + sequence), sequence, 0.0)
                for n, codec in enumerate(codecs.values())]  # fmt: skip
        for messages in zip(*rows, strict=True):  # their messages interleave
            for message in messages:
                sender.send(message)
    router = Router(codecs)
    frames = frames_in(reader, router)
    for n, (name, codec) in enumerate(codecs.items()):
        own = [frame for sensor, frame in frames if sensor == name]
        assert len(own) == 30
        assert router.assemblers[name].loss.lost == 0
        for frame in own:
            np.testing.assert_array_equal(frame.counts, counts_of(codec, 50 * n + frame.sequence))


def test_drops_under_overload_are_counted_to_the_message(bus, small):
    reader, sender = small(2048), bus()
    sent = 0
    for sequence in range(100):
        for message in SMALL.encode(counts_of(SMALL, sequence), sequence, 0.0):
            sender.send(message)
            sent += 1
    router = Router({"it": SMALL})
    received, frames = 0, []

    def take():
        nonlocal received, frames
        while (message := reader.receive(0.3)) is not None:
            received += 1
            frames += router.push(message)

    take()
    for message in SMALL.encode(counts_of(SMALL, 100), 100, 0.0):  # after it, what was lost before is known
        sender.send(message)
        sent += 1
    take()
    loss = router.assemblers["it"].loss
    assert loss.lost > 200
    assert loss.lost == sent - received
    assert frames[-1][1].sequence == 100
    for _, frame in frames:
        known = frame.flags == 0
        np.testing.assert_array_equal(frame.counts[known], counts_of(SMALL, frame.sequence)[known])


def test_a_link_that_goes_down_and_comes_back(bus, link):
    reader = bus()
    link("vcan0", "down")
    with pytest.raises(BusError, match=r"the interface is down: `ip link set CHANNEL up`"):
        reader.receive(1.0)
    with pytest.raises(BusError, match=r"the interface is down"):
        bus().send(Message(0.0, 0x500, b"\0"))
    link("vcan0", "up")
    sender = bus()
    sender.send(Message(0.0, 0x500, b"\7"))
    assert reader.receive(1.0).data == b"\7"


def test_the_peers_are_there():
    for name in ("cangen", "candump", "canplayer"):
        assert shutil.which(name), f"{name}: install can-utils"


def test_what_the_kernel_dropped_is_told_at_once(bus, small):
    reader, sender = small(2048), bus()
    for _ in range(300):
        sender.send(Message(0.0, 0x500, bytes(8)))
    dropped, received = reader.dropped, 0
    while reader.receive(0.3) is not None:
        received += 1
    assert dropped > 200
    assert dropped + received == 300


def test_a_readers_buffer_holds_a_burst(bus):
    reader = bus()
    assert reader._bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= BUFFER_BYTES


def test_the_kernel_holds_back_what_no_sensor_listens_to():
    settings = only({"interface": "socketcan", "channel": "vcan0"}, SMALL.ids | {(0x18FF0000, True)})
    reader, sender = open_bus(**settings), open_bus(interface="socketcan", channel="vcan0")
    try:
        for id_, extended in ((0x123, False), (0x500, True), (0x500, False), (0x18FF0000, True)):
            sender.send(Message(0.0, id_, b"\1", extended))
        got = [reader.receive(1.0), reader.receive(1.0)]
        assert [(each.id, each.extended) for each in got] == [(0x500, False), (0x18FF0000, True)]
        assert reader.receive(0.3) is None
    finally:
        reader.close()
        sender.close()


def test_two_buses_at_once_lose_nothing():
    buses = [{"interface": "socketcan", "channel": name} for name in ("vcan0", "vcan1")]
    told = live(buses, rate=8000, seconds=0.5)  # less than a socket's buffer holds, however busy the machine is
    assert (told.sent, told.received, told.lost) == (4000, 4000, 0)


@pytest.mark.parametrize("fd", [False, True])
def test_many_frames_for_one_call_are_those_of_python_can(bus, fd):
    sender, reader, other = bus(fd), bus(fd), bus(fd)
    for n in range(600):
        extended = n % 2 == 1
        sender.send(Message(0.0, n + (extended << 20), bytes([n % 256]) * (n % 9), extended, fd and n % 3 == 0))
    taken = []
    while batch := reader.batch(0.5):
        taken += batch
    theirs = [other.frame(1.0) for _ in range(600)]
    assert [
        Message(each.timestamp, each.arbitration_id, bytes(each.data), each.is_extended_id, each.is_fd)
        for each in theirs
    ] == taken
