"""Many frames from a Linux CAN socket for one system call (recvmmsg), with the kernel's times."""

import ctypes
import errno
import os
import select
import socket
import struct
import sys
from typing import NamedTuple

MAX_FRAMES = 256  # a call
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000  # in a frame's id
SO_TIMESTAMPNS = 35  # Linux's
FRAME = struct.Struct("=IB3x64s")  # id, length, data: of CAN FD; a classic frame fills less of it
PART = struct.Struct("@PN")  # struct iovec
STAMP = struct.Struct("@16xqQ")  # an ancillary message's header, then s and ns
HEADER = struct.Struct("@PI4xPNPNi4xI4x")  # struct mmsghdr
SIZE = struct.Struct(f"@{HEADER.size - 8}xI4x")  # bytes received, in one


class Frame(NamedTuple):
    """One frame of any kind."""

    time: float  # s, Unix time, when the kernel received it
    id: int  # with the flags EXTENDED, REMOTE, ERROR
    data: bytes
    fd: bool


class FrameReader:
    """Takes what has come on a socket that is `supported`."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)
        self._recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._frames, self._stamps, self._parts, self._headers = (
            ctypes.create_string_buffer(MAX_FRAMES * each.size) for each in (FRAME, STAMP, PART, HEADER)
        )
        frame, stamp, part = map(ctypes.addressof, (self._frames, self._stamps, self._parts))
        for n in range(MAX_FRAMES):
            PART.pack_into(self._parts, n * PART.size, frame + n * FRAME.size, FRAME.size)
            header = (0, 0, part + n * PART.size, 1, stamp + n * STAMP.size, STAMP.size, 0, 0)
            HEADER.pack_into(self._headers, n * HEADER.size, *header)
        self._blank = self._headers.raw

    @staticmethod
    def supported(candidate: socket.socket) -> bool:
        """Whether this machine's frames have the layout above, and the socket stamps its own."""
        linux_64 = sys.platform == "linux" and sys.maxsize > 1 << 32
        return linux_64 and candidate.getsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS) == 1

    def read(self, timeout: float) -> list[Frame]:
        """At most MAX_FRAMES, in order; waits up to `timeout` (s) for the first; OSError."""
        if not self._poll.poll(1000 * timeout):
            return []
        ctypes.memmove(self._headers, self._blank, len(self._blank))  # the kernel has written into them
        count = self._recvmmsg(self._descriptor, self._headers, MAX_FRAMES, socket.MSG_DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            if code == errno.EAGAIN:
                return []
            raise OSError(code, os.strerror(code))
        frames, stamps, sizes = (
            each.iter_unpack(memoryview(buffer)[: count * each.size])
            for each, buffer in ((FRAME, self._frames), (STAMP, self._stamps), (SIZE, self._headers))
        )
        return [
            Frame(s + 1e-9 * ns, id_, data[:length], size == FRAME.size)
            for (id_, length, data), (s, ns), (size,) in zip(frames, stamps, sizes, strict=True)
        ]
