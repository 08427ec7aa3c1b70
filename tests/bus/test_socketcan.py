"""SocketCAN's frames, as bytes, over a socket that any Linux has and that stamps them the same way."""

import errno
import os
import socket
import struct
import time
from threading import Timer

import pytest

from tactiled.bus.socketcan import ERROR, EXTENDED, MAX_FRAMES, REMOTE, SO_TIMESTAMPNS, Frame, FrameReader


@pytest.fixture
def ends():
    ours, theirs = socket.socketpair(type=socket.SOCK_DGRAM)
    with ours, theirs:
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        theirs.settimeout(5.0)
        yield ours, theirs


def classic(id_, data):
    return struct.pack("=IB3x8s", id_, len(data), data)


def flexible(id_, data):
    return struct.pack("=IBB2x64s", id_, len(data), 0x05, data)


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("id_", [0x7FF, EXTENDED | 0x1FFFFFFF, REMOTE | 0x123, ERROR | 0x44])
def test_a_frame_comes_as_it_was_sent_with_the_kernels_time(ends, id_, fd):
    ours, theirs = ends
    data = bytes(range(64 if fd else 5))
    began = time.time()
    theirs.send((flexible if fd else classic)(id_, data))
    (got,) = FrameReader(ours.fileno()).read(1.0)
    assert got == Frame(got.time, id_, data, fd)
    assert began - 0.01 <= got.time <= time.time()


def test_what_has_come_comes_at_once_and_in_order(ends):
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    for round_ in range(3):
        for n in range(7):
            theirs.send(classic(n, bytes((round_, n)) * (n % 4)))
        got = reader.read(1.0)
        assert [(each.id, each.data) for each in got] == [(n, bytes((round_, n)) * (n % 4)) for n in range(7)]
        assert [each.time for each in got] == sorted(each.time for each in got)


def test_short_and_long_frames_mix(ends):
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    for _ in range(2):  # the second time over what the first has left behind
        theirs.send(flexible(1, bytes(range(48))))
        theirs.send(classic(2, b"\7\7"))
        theirs.send(flexible(3, b""))
        assert [each[1:] for each in reader.read(1.0)] == [
            (1, bytes(range(48)), True),
            (2, b"\7\7", False),
            (3, b"", True),
        ]


def test_frames_beyond_one_call_come_at_the_next_and_a_later_one_is_waited_for(ends, monkeypatch):
    assert MAX_FRAMES >= 64
    monkeypatch.setattr("tactiled.bus.socketcan.MAX_FRAMES", 4)  # a socket of this kind holds little
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    for n in range(8):
        theirs.send(classic(n, b""))
    assert [[each.id for each in reader.read(0.0)] for _ in range(3)] == [[0, 1, 2, 3], [4, 5, 6, 7], []]
    Timer(0.1, theirs.send, (classic(9, b""),)).start()
    assert [each.id for each in reader.read(30.0)] == [9]


def test_nothing_comes_of_a_bus_that_falls_silent_and_it_is_waited_for(ends):
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    theirs.send(classic(1, b""))
    assert len(reader.read(0.05)) == 1
    began = time.monotonic()
    assert reader.read(0.05) == []
    assert time.monotonic() - began >= 0.05


def test_a_frame_without_a_time_costs_the_next_ones_nothing(ends):
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    for stamps in (0, 1):
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, stamps)
        theirs.send(classic(1, b""))
        (got,) = reader.read(1.0)
    assert got.time == pytest.approx(time.time(), abs=5.0)


def test_an_error_of_the_socket_is_raised():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
            closed.bind(("127.0.0.1", 0))
            ours.connect(closed.getsockname())
        ours.send(b"x")
        with pytest.raises(ConnectionRefusedError, match=os.strerror(errno.ECONNREFUSED)):
            FrameReader(ours.fileno()).read(5.0)


def test_only_a_socket_that_stamps_its_frames_fits(ends):
    assert [FrameReader.supported(each) for each in ends] == [True, False]
