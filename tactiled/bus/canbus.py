"""All that the package uses of python-can; no other module imports it."""

from can import (
    VALID_INTERFACES,
    ASCReader,
    ASCWriter,
    BLFReader,
    BLFWriter,
    Bus,
    BusABC,
    CanutilsLogReader,
    CanutilsLogWriter,
    CSVReader,
    LogReader,
    TRCReader,
)
from can import Message as CanMessage
from can.interfaces.slcan import slcanBus as SlcanBus
from can.interfaces.socketcan import SocketcanBus
from can.io import blf
from can.io.generic import MessageReader, MessageWriter
from can.util import channel2int

__all__ = [
    "VALID_INTERFACES", "ASCReader", "ASCWriter", "BLFReader", "BLFWriter", "Bus", "BusABC", "CSVReader",
    "CanMessage", "CanutilsLogReader", "CanutilsLogWriter", "LogReader", "MessageReader", "MessageWriter",
    "SlcanBus", "SocketcanBus", "TRCReader", "blf", "channel2int",
]  # fmt: skip
