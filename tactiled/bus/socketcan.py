"""Many frames from a Linux CAN socket for one system call (recvmmsg), with the kernel's times."""

import ctypes
import errno
import os
import select
import socket
import struct
import sys
import time

import numpy as np

from tactiled.bus.batch import COLUMNS, MAX_BYTES, Batch

# What error frames report, by the kernel's linux/can/error.h.
BUS_OFF, RESTARTED = "bus_off", "restarted"
CLASSES = {
    0x001: "tx_timeout",
    0x002: "lost_arbitration",
    0x008: "protocol",
    0x010: "transceiver",
    0x020: "no_ack",
    0x040: BUS_OFF,
    0x080: "bus_error",
    0x100: RESTARTED,
}  # bits of the id
CONTROLLER = 0x004  # the bit of the id with which byte 1 of the data reports more
STATES = {
    0x01: "rx_overflow",
    0x02: "tx_overflow",
    0x04: "rx_warning",
    0x08: "tx_warning",
    0x10: "rx_passive",
    0x20: "tx_passive",
    0x40: "active",
}  # bits of that byte
OTHER = "other"  # none of these, or the interface does not report which
KINDS = (*CLASSES.values(), *STATES.values(), "controller", OTHER)

MAX_FRAMES = 256  # a call
REMOTE, ERROR = 0x40000000, 0x20000000  # in a frame's id, as EXTENDED is
SO_TIMESTAMPNS = 35  # Linux's
GATHER_S = 5e-3  # that a read takes at the longest to fetch what it is asked for behind the first frame
MIN_FRAME_S = 40e-6  # of the shortest frame at 1 Mbit/s (44 bits): a bus brings no more within less time
FRAME = np.dtype(
    {
        "names": ["id", "length", "data"],
        "formats": ["=u4", "u1", ("u1", MAX_BYTES)],
        "offsets": [0, 4, 8],
        "itemsize": 72,
    }
)  # of CAN FD; a classic frame fills less of it
PART = struct.Struct("@PN")  # struct iovec
STAMP = np.dtype({"names": ["s", "ns"], "formats": ["=i8", "=i8"], "offsets": [16, 24], "itemsize": 32})
HEADER = struct.Struct("@PI4xPNPNi4xI4x")  # struct mmsghdr
SIZE = np.dtype({"names": ["bytes"], "formats": ["=u4"], "offsets": [56], "itemsize": HEADER.size})


class FrameReader:
    """Takes what has come on a socket that is `supported`."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)
        self._recvmmsg = ctypes.PyDLL(None, use_errno=True).recvmmsg  # never waits, so it keeps the interpreter
        self._buffer = bytearray(MAX_FRAMES * FRAME.itemsize)
        stamps = np.zeros(MAX_FRAMES, STAMP)
        self._stamps = stamps["s"], stamps["ns"]
        self._parts = ctypes.create_string_buffer(MAX_FRAMES * PART.size)
        self._headers = ctypes.create_string_buffer(MAX_FRAMES * HEADER.size)
        self._header_bytes = memoryview(self._headers).cast("B")
        self._sizes = np.frombuffer(self._header_bytes, SIZE)["bytes"]
        frame, stamp = np.frombuffer(self._buffer).ctypes.data, stamps.ctypes.data
        part = ctypes.addressof(self._parts)
        for n in range(MAX_FRAMES):
            PART.pack_into(self._parts, n * PART.size, frame + n * FRAME.itemsize, FRAME.itemsize)
            header = (0, 0, part + n * PART.size, 1, stamp + n * STAMP.itemsize, STAMP.itemsize, 0, 0)
            HEADER.pack_into(self._headers, n * HEADER.size, *header)
        self._blank = memoryview(self._headers.raw)
        self._error: OSError | None = None  # that came behind frames: a socket reports one only once

    @staticmethod
    def supported(candidate: socket.socket) -> bool:
        """Whether this machine's frames have the layout above, and the socket stamps its own."""
        linux_64 = sys.platform == "linux" and sys.maxsize > 1 << 32
        return linux_64 and candidate.getsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS) == 1

    def read(self, timeout: float, needed: int = 1) -> Batch:
        """At most MAX_FRAMES, in order, their ids with the flags REMOTE and ERROR; OSError.

        Waits up to `timeout` (s) for the first, and for up to GATHER_S longer until there are `needed`.
        """
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        count = self._receive(0) if self._poll.poll(1000 * timeout) else 0
        if 0 < count < needed:
            end = time.monotonic() + min(GATHER_S, timeout)
            while count < min(needed, MAX_FRAMES) and not self._error and (rest := end - time.monotonic()) > 0:
                time.sleep(min(rest, MIN_FRAME_S * (needed - count)))
                count += self._receive(count)
        return self._batch(count)

    def _receive(self, at: int) -> int:
        """Take what is there behind the first `at` frames; how many."""
        headers = ctypes.c_void_p(ctypes.addressof(self._headers) + at * HEADER.size)
        count = self._recvmmsg(self._descriptor, headers, MAX_FRAMES - at, socket.MSG_DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            if code == errno.EAGAIN:
                return 0
            error = OSError(code, os.strerror(code))
            if not at:
                raise error
            self._error = error
            return 0
        return int(count)

    def _batch(self, count: int) -> Batch:
        frames = np.frombuffer(self._buffer[: count * FRAME.itemsize], FRAME)
        lengths, data, (seconds, ns) = frames["length"], frames["data"], self._stamps
        if np.minimum.reduce(lengths, initial=MAX_BYTES) < MAX_BYTES:  # behind their data may be anything
            data *= lengths[:, None] > COLUMNS
        fd, end = self._sizes[:count] == FRAME.itemsize, count * HEADER.size
        self._header_bytes[:end] = self._blank[:end]  # the kernel has written into them
        return Batch(seconds[:count] + 1e-9 * ns[:count], frames["id"], lengths, data, fd)


def error_kinds(id_: int, data: bytes) -> tuple[str, ...]:
    """Every kind, of KINDS, that an error frame reports."""
    reported = [kind for bit, kind in CLASSES.items() if id_ & bit]
    if id_ & CONTROLLER:
        states = data[1] if len(data) > 1 else 0
        reported += [kind for bit, kind in STATES.items() if states & bit] or ["controller"]
    return tuple(reported) or (OTHER,)
