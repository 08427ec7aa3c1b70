"""CAN data frames as arrays, in order of arrival: from one read of a bus, or from a piece of a file."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Message

Key = tuple[int, bool]  # CAN id, whether it has 29 bits
EXTENDED = 0x80000000  # in an id: it has 29 bits, as SocketCAN marks it
MAX_BYTES = 64  # of a message
COLUMNS = np.arange(MAX_BYTES, dtype=np.uint8)
PACKED = Struct(f"=dIB?{MAX_BYTES}s2x")  # one message in bytes, and these as arrays
ROW = np.dtype(
    [("time", "f8"), ("id", "u4"), ("length", "u1"), ("fd", "?"), ("data", "u1", MAX_BYTES)], align=True
)


@dataclass(slots=True, eq=False)
class Batch:
    """Some messages (n), in the order in which they came; never changed once it is made."""

    times: NDArray[np.float64]  # (n,) s
    ids: NDArray[np.uint32]  # (n,) with EXTENDED
    lengths: NDArray[np.uint8]  # (n,) bytes of the data; 255: that many or more, which no CAN message has
    data: NDArray[np.uint8]  # (n, MAX_BYTES), 0 past the length
    fd: NDArray[np.bool_]  # (n,)

    @classmethod
    def of(cls, messages: Iterable[Message]) -> "Batch":
        """A batch of single messages."""
        rows = [
            PACKED.pack(time, id_ | EXTENDED if extended else id_, min(len(data), 255), fd, data)
            for time, id_, data, extended, fd in messages
        ]
        table = np.frombuffer(b"".join(rows), ROW)
        return cls(table["time"], table["id"], table["length"], table["data"], table["fd"])

    def __len__(self) -> int:
        """Number of messages."""
        return len(self.times)

    def __getitem__(self, rows: Any) -> "Batch":
        """Some of the messages: a slice, their numbers or a mask."""
        return Batch(self.times[rows], self.ids[rows], self.lengths[rows], self.data[rows], self.fd[rows])

    def __iter__(self) -> Iterator[Message]:
        """Message after message."""
        columns = zip(self.times.tolist(), self.ids.tolist(), self.lengths.tolist(), self.fd.tolist(), strict=True)
        data = self.data.tobytes()
        for at, (time, id_, length, fd) in enumerate(columns):
            row = data[at * MAX_BYTES : at * MAX_BYTES + min(length, MAX_BYTES)].ljust(length, b"\0")
            yield Message(time, id_ & ~EXTENDED, row, id_ >= EXTENDED, fd)
