"""What a connection may take in each of its states: how long, how many bytes, in which pieces."""

from dataclasses import dataclass
from enum import Enum, auto

KIB, MIB = 1 << 10, 1 << 20


class Phase(Enum):
    """What a connection does now."""

    TLS = auto()  # the handshake
    HEAD = auto()  # a request line and headers, the first bytes of a connection included
    BODY = auto()  # a request's body and trailers
    UPLOAD = auto()  # the same of a recording
    ANSWERING = auto()  # the whole request has come
    IDLE = auto()  # between two requests
    UPGRADING = auto()  # a WebSocket's handshake, until it is answered
    STREAMING = auto()  # a WebSocket
    CLOSING = auto()  # the last byte for the client is on its way; what it still sends is not used


@dataclass(frozen=True)
class Bound:
    """The bound of one state; None: another part of the service bounds it, as the table says."""

    seconds: float | None
    bytes: int | None  # received in this state
    piece: int = 16 * KIB  # bytes handled before other connections have their turn
    share: float = 1.0  # of the event loop's time that the client's bytes may take
    evictable: bool = False  # for a new connection where no place is left: no valid request is at work


BOUNDS = {
    Phase.TLS: Bound(10.0, None, evictable=True),  # bytes: OpenSSL's own bound on a handshake
    Phase.HEAD: Bound(10.0, 80 * KIB, evictable=True),  # h11 answers 431 to more than MAX_HEAD
    Phase.BODY: Bound(62.0, 80 * MIB),  # `Body` answers 408 after 60 s, and 413 by route; h11 bounds trailers
    Phase.UPLOAD: Bound(602.0, 1280 * MIB),  # `Body`: 408 after 600 s, 413 above 1 GiB
    Phase.ANSWERING: Bound(None, None),  # time: the resource's, and UNREAD_S; nothing is read meanwhile
    Phase.IDLE: Bound(5.0, 0, evictable=True),
    Phase.UPGRADING: Bound(10.0, 64 * KIB),
    Phase.STREAMING: Bound(None, None, piece=KIB, share=0.1),  # time: pings; bytes: MAX_MESSAGE a message
    Phase.CLOSING: Bound(2.0, MIB, piece=KIB, share=0.1, evictable=True),
}
MAX_HEAD = 64 * KIB  # bytes of a head, of a chunk's header, of trailers: each is held until it is complete
MAX_CLOSING_PARSED = 16 * KIB  # bytes searched for the answer to a close frame, before the rest is thrown away
MAX_FRAGMENTS = 64  # frames of one WebSocket message
BURST_S = 0.05  # of the event loop's time, before `share` holds
SHUTDOWN_S = 0.6  # that answers under way may take once the service ends
UNREAD_S = 20.0  # that a client may take nothing of what it is sent
