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
    for round_ in range(3):  # from the second on over what the one before has left behind
        frames = [(n, bytes((round_, n)) * (n * n % 5), n % 2 == 1) for n in range(7)]
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, round_)  # a frame without a time spoils no other
        for id_, data, fd in frames:
            theirs.send((flexible if fd else classic)(id_, data))
        got = reader.read(1.0)
        assert [each[1:] for each in got] == frames
        if round_:
            assert [each.time for each in got] == sorted(each.time for each in got)
            assert got[0].time == pytest.approx(time.time(), abs=5.0)
    began = time.monotonic()
    assert reader.read(0.05) == []  # a silent bus is waited for
    assert time.monotonic() - began >= 0.05


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
