"""A film of classic CAN messages onto SocketCAN as cheaply as it goes, so that its reader is what is measured."""

import ctypes
import os
import socket
import struct
from collections.abc import Sequence
from typing import Self

from tactiled.bus.burst import HEADER, PART
from tactiled.errors import BusError
from tactiled.frames import Message

FRAME = struct.Struct("=IB3x8s")  # id, length, data
MOST = 1024  # frames a call, as Linux has it


class Blast:
    """Sends `messages` (11-bit ids, up to 8 bytes) over and over, many for one system call (sendmmsg)."""

    def __init__(self, channel: str, messages: Sequence[Message]) -> None:
        self._count, self._at = len(messages), 0
        self._frames = ctypes.create_string_buffer(
            b"".join(FRAME.pack(each.id, len(each.data), each.data) for each in messages)
        )
        self._parts = ctypes.create_string_buffer(self._count * PART.size)
        self._headers = ctypes.create_string_buffer(self._count * HEADER.size)
        frame, part = ctypes.addressof(self._frames), ctypes.addressof(self._parts)
        for n in range(self._count):
            PART.pack_into(self._parts, n * PART.size, frame + n * FRAME.size, FRAME.size)
            HEADER.pack_into(self._headers, n * HEADER.size, 0, 0, part + n * PART.size, 1, 0, 0, 0, 0)
        self._call = ctypes.CDLL(None, use_errno=True).sendmmsg
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")  # it hears nothing
        self._socket.bind((channel,))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, count: int) -> None:
        """Send the next so many messages; BusError where the bus does not take them."""
        while count:
            asked = min(count, MOST, self._count - self._at)
            at = ctypes.addressof(self._headers) + self._at * HEADER.size
            sent = self._call(self._socket.fileno(), ctypes.c_void_p(at), asked, 0)
            if sent < 0:
                raise BusError(f"sendmmsg: {os.strerror(ctypes.get_errno())}")
            count, self._at = count - sent, (self._at + sent) % self._count
