"""One limit of connections for a client and for all; where none is left, who sends no request makes room."""

import resource
from collections.abc import Callable
from dataclasses import dataclass

MAX_CONNECTIONS = 1024  # or twice as many as streams are allowed
CLIENT_SHARE = 0.5  # of all places, for one client: others always find one
DESCRIPTOR_SHARE = 0.4  # of the process's descriptors, for each of two servers: buses and files need the rest


@dataclass(frozen=True, eq=False)
class Place:
    """An open connection as the limit sees it."""

    client: str  # address
    evictable: Callable[[], bool]
    drop: Callable[[], None]


def limit(streams: int) -> int:
    """How many connections there may be beside so many streams, with the process's limit of descriptors."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return min(max(MAX_CONNECTIONS, 2 * streams), int(soft * DESCRIPTOR_SHARE))


class Places:
    """The open connections of one server, oldest first; lives on its event loop."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._open: dict[Place, None] = {}
        self.dropped = {"evicted": 0, "refused": 0}  # so far

    @property
    def open(self) -> int:
        """How many there are now."""
        return len(self._open)

    def take(self, place: Place) -> bool:
        """Take a place, that of the oldest connection without a request if need be; False where none is left."""
        crowd = self._crowd(place.client)
        if crowd is not None:
            oldest = next((each for each in crowd if each.evictable()), None)
            if oldest is None:
                self.dropped["refused"] += 1
                return False
            self.dropped["evicted"] += 1
            self.free(oldest)
            oldest.drop()
        self._open[place] = None
        return True

    def free(self, place: Place) -> None:
        """Give a place back; one that was given back already stays so."""
        self._open.pop(place, None)

    def _crowd(self, client: str) -> list[Place] | None:
        """The connections of which one is too many, if one more would be."""
        if self.open < self._limit * CLIENT_SHARE:
            return None
        own = [each for each in self._open if each.client == client]
        is_proxy = client == "::1" or client.startswith("127.")  # on this machine, it may speak for many clients
        if not is_proxy and len(own) >= self._limit * CLIENT_SHARE:
            return own
        return list(self._open) if self.open >= self._limit else None
