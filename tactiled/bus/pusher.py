"""Puts frames that a program pushes on the bus, inside this process, from which their sensor reads."""

from threading import Lock

from tactiled.bus.canbus import Bus, can_message
from tactiled.bus.codec import Codec
from tactiled.errors import BusError
from tactiled.frames import Counts

SEND_S = 5.0  # to wait for room in the queue of a reader that does not keep up


class Pusher:
    """The sending end of such a bus; any thread may push."""

    def __init__(self, channel: str) -> None:
        self._bus = Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        self._lock = Lock()
        self._next = 0  # sequence number of a frame that bears none

    def push(self, codec: Codec, counts: Counts, sequence: int | None, time_s: float) -> int:
        """Send the messages of a frame (N,); gives its sequence number. BusError if its reader has no room."""
        with self._lock:
            number = self._next if sequence is None else sequence
            self._next = number + 1
            for each in codec.encode(counts, number, time_s):
                try:
                    self._bus.send(can_message(each), SEND_S)
                except Exception as error:  # python-can's, where a queue is full
                    raise BusError(f"the service does not keep up: {error}") from error
        return number

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()
