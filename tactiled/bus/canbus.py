"""All that the package uses of python-can; no other module imports it."""

from can import VALID_INTERFACES, Bus, BusABC
from can import Message as CanMessage
from can import io as formats
from can.interfaces.slcan import slcanBus as SlcanBus
from can.interfaces.socketcan import SocketcanBus
from can.io import blf
from can.io.generic import MessageReader, MessageWriter
from can.util import channel2int, dlc2len

__all__ = [
    "VALID_INTERFACES", "Bus", "BusABC", "CanMessage", "MessageReader", "MessageWriter", "SlcanBus",
    "SocketcanBus", "blf", "channel2int", "dlc2len", "formats",
]  # fmt: skip
