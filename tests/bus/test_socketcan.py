"""SocketCAN's frames, as bytes, over a socket that any Linux has and that stamps them the same way."""

import errno
import os
import socket
import struct
import time
from threading import Timer

import pytest

from tactiled.bus.batch import EXTENDED
from tactiled.bus.socketcan import ERROR, MAX_FRAMES, REMOTE, SO_TIMESTAMPNS, FrameReader


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


def content(batch):
    """(time, id with its flags, data, FD) of every frame; nothing stands behind the data."""
    assert not any(row[length:].any() for row, length in zip(batch.data, batch.lengths, strict=True))
    data = [bytes(row[:length]) for row, length in zip(batch.data, batch.lengths, strict=True)]
    return list(zip(batch.times.tolist(), batch.ids.tolist(), data, batch.fd.tolist(), strict=True))


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("id_", [0x7FF, EXTENDED | 0x1FFFFFFF, REMOTE | 0x123, ERROR | 0x44])
def test_a_frame_comes_as_it_was_sent_with_the_kernels_time(ends, id_, fd):
    ours, theirs = ends
    data = bytes(range(64 if fd else 5))
    began = time.time()
    theirs.send((flexible if fd else classic)(id_, data))
    ((stamp, *got),) = content(FrameReader(ours.fileno()).read(1.0))
    assert got == [id_, data, fd]
    assert began - 0.01 <= stamp <= time.time()


def test_what_has_come_comes_at_once_and_in_order(ends):
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    for round_ in range(3):  # from the second on over what the one before has left behind
        frames = [(n, bytes((round_, n)) * (n * n % 5), n % 2 == 1) for n in range(7)]
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, round_)  # a frame without a time spoils no other
        for id_, data, fd in frames:
            theirs.send((flexible if fd else classic)(id_, data))
        got = content(reader.read(1.0))
        assert [each[1:] for each in got] == frames
        if round_:
            times = [each[0] for each in got]
            assert times == sorted(times)
            assert times[0] == pytest.approx(time.time(), abs=5.0)
    began = time.monotonic()
    assert len(reader.read(0.05)) == 0  # a silent bus is waited for
    assert time.monotonic() - began >= 0.05


def test_frames_beyond_one_call_come_at_the_next_and_a_later_one_is_waited_for(ends, monkeypatch):
    assert MAX_FRAMES >= 64
    monkeypatch.setattr("tactiled.bus.socketcan.MAX_FRAMES", 4)  # a socket of this kind holds little
    ours, theirs = ends
    reader = FrameReader(ours.fileno())
    for n in range(8):
        theirs.send(classic(n, b""))
    assert [reader.read(0.0).ids.tolist() for _ in range(3)] == [[0, 1, 2, 3], [4, 5, 6, 7], []]
    Timer(0.1, theirs.send, (classic(9, b""),)).start()
    assert reader.read(30.0).ids.tolist() == [9]


def test_frames_that_are_needed_are_fetched_in_one_read_and_an_error_behind_them_is_kept(ends, monkeypatch):
    ours, theirs = ends
    monkeypatch.setattr("tactiled.bus.socketcan.GATHER_S", 30.0)
    reader, waits = FrameReader(ours.fileno()), []

    def bring(_):
        waits.append(len(waits))
        theirs.send(classic(len(waits), b"later"))

    monkeypatch.setattr("tactiled.bus.socketcan.time.sleep", bring)
    theirs.send(flexible(0, bytes(range(64))))
    got = content(reader.read(60.0, needed=3))
    assert [each[1:] for each in got] == [(0, bytes(range(64)), True), (1, b"later", False), (2, b"later", False)]
    monkeypatch.setattr("tactiled.bus.socketcan.time.sleep", lambda _: os.dup2(pipe, ours.fileno()))
    pipe, other = os.pipe()  # no socket: recvmmsg fails on it
    theirs.send(classic(3, b""))
    assert reader.read(60.0, needed=2).ids.tolist() == [3]
    with pytest.raises(OSError, match="Socket operation on non-socket"):
        reader.read(0.0)
    for each in (pipe, other):
        os.close(each)


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
