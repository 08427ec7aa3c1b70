"""XELA's own server as a bus: its JSON on a WebSocket, as the CAN messages of the codec `xela`.

Sources of the format: those of interop/xela.py. Module N of the server is microcontroller N. Its taxels are those
of the squarest grid, such as 4 x 6 of 24 and 4 x 4 of 16; SDAs fall from the top row down, taxel numbers from left
to right, as on a module with its connector on the left.
"""

import json
import time
from collections import deque
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.bus.canbus import BusABC, CanMessage

STATUS = 0x83  # first byte of a taxel's message
MAX_SDA, MAX_TAXEL, MAX_CONTROLLER = 7, 15, 15
OPEN_S = 5.0  # until the server answers
MAX_MESSAGE_BYTES = 1 << 20


class XelaServerBus(BusABC):
    """The server at `channel`, such as ws://127.0.0.1:5000; nothing is sent to it."""

    def __init__(self, channel: str, **settings: Any) -> None:
        """Connect; OSError or TimeoutError where nobody answers."""
        self._open = ExitStack()
        self._socket = self._open.enter_context(connect(channel, open_timeout=OPEN_S, max_size=MAX_MESSAGE_BYTES))
        self._waiting: deque[CanMessage] = deque()
        self._times: dict[int, float] = {}  # of each module's newest frame, s
        super().__init__(channel=channel, **settings)

    def _recv_internal(self, timeout: float | None) -> tuple[CanMessage | None, bool]:
        """The next message; ValueError for what is no message of that server, ConnectionError at the end."""
        end = None if timeout is None else time.monotonic() + timeout
        while not self._waiting:
            try:
                text = self._socket.recv(None if end is None else max(0.0, end - time.monotonic()))
            except TimeoutError:
                return None, False
            except ConnectionClosed as error:
                raise ConnectionError(f"the server closed the connection: {error.rcvd or 'no reason'}") from None
            self._waiting.extend(self._messages(text))
        return self._waiting.popleft(), False

    def _messages(self, text: str | bytes) -> list[CanMessage]:
        """The messages of every module that has a new frame, [] of a welcome; ValueError for anything else."""
        try:
            modules = [(int(key), each) for key, each in json.loads(text).items() if key.isdecimal()]
            found = [(number, float(each["time"]), _axes(each)) for number, each in modules]
            messages = []
            for number, time_s, axes in found:
                ids = _ids(number, len(axes))
                if self._times.get(number) != time_s:
                    self._times[number] = time_s
                    messages += [_message(time_s, id_, row) for id_, row in zip(ids, axes, strict=True)]
            return messages
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            fault = f"no message of XELA's server: {type(error).__name__}: {error}"
        raise ValueError(fault)  # outside of `except`: an error with a cause would count as a fault of the bus

    def send(self, msg: CanMessage, timeout: float | None = None) -> None:
        """The server takes none."""
        raise NotImplementedError("XELA's server takes no messages")

    def shutdown(self) -> None:
        """Close the connection."""
        super().shutdown()
        self._open.close()


def _axes(module: dict[str, Any]) -> NDArray[np.uint16]:
    """X, Y and Z (N, 3) of every taxel; ValueError where they are not of 16 bits each."""
    if "integer" in module:
        counts = np.array(module["integer"], np.int64)
    else:
        counts = np.array([int(each, 16) for each in module["data"].split(",")], np.int64)
    if counts.ndim != 1 or not counts.size or counts.size % 3 or ((counts < 0) | (counts > 0xFFFF)).any():
        raise ValueError(f"counts {counts.shape}: expected three of 16 bits for each taxel")
    return counts.astype(np.uint16).reshape(-1, 3)


def _ids(module: int, size: int) -> list[int]:
    """The ids of a module's taxels; ValueError where there is no such grid or microcontroller."""
    rows = max(each for each in range(1, MAX_SDA + 1) if size % each == 0 and each * each <= size)
    columns = size // rows
    if columns > MAX_TAXEL + 1 or module > MAX_CONTROLLER:
        raise ValueError(f"module {module} of {size} taxels: the ids of XELA's modules cannot name them")
    return [sda << 8 | taxel << 4 | module for sda in range(rows, 0, -1) for taxel in range(columns - 1, -1, -1)]


def _message(time_s: float, id_: int, row: NDArray[np.uint16]) -> CanMessage:
    data = bytes((STATUS, *row.astype(">u2").tobytes(), 0))
    return CanMessage(time_s, id_, is_extended_id=False, data=data)
