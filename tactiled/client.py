"""A client of the service: live images as numpy arrays, reconnecting; and the few things one asks of it.

import tactiled

for image in tactiled.connect("http://127.0.0.1:8000").stream("palm"):
    print(image.sequence, image.restored.max(), "kPa")
"""

import asyncio
import json
import logging
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote, urlencode, urlsplit
from urllib.request import Request, urlopen

import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.sync.client import connect as connect_sync

from tactiled.errors import ConfigError, TactileError
from tactiled.web.wire import KINDS, PRESSURES, Kind, Unpacked, unpack

LOG = logging.getLogger(__name__)
ANSWER_S = 10.0  # that the service may take to answer
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before the next attempt to connect
LOST = OSError, ConnectionClosed, InvalidHandshake, InvalidURI  # TimeoutError is an OSError
TOO_MANY = 4429  # of this client: a place may come free
REFUSED = set(range(4400, 4500)) - {TOO_MANY}  # close codes that another attempt will meet again


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One frame, raw and restored, and its shear if that was asked for."""

    raw: NDArray[np.float32]  # kPa, (rows, columns); one row where the layout is no grid; NaN: unknown
    restored: NDArray[np.float32]  # kPa
    flags: NDArray[np.uint8]  # a raw taxel's 1 missing | 2 bad | 4 dead | 8 saturated
    sequence: int
    timestamp: float  # s, Unix, of the frame's first CAN message
    noise_kpa: float
    resolution_mm: float
    status: dict[str, Any] = field(default_factory=dict)  # what the stream said last: state, loss, warnings, ...
    sensor: str = ""
    shear: NDArray[np.float32] | None = None  # counts along x and y, (2, rows, columns); NaN: unknown


def connect(url: str, token: str | None = None) -> "Client":
    """A client of the service at `url`; nothing is sent yet. ConfigError where that is no http address."""
    if urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).hostname:
        raise ConfigError(f"url = {url!r}: give the service's address, such as http://127.0.0.1:8000")
    return Client(url.rstrip("/"), token)


class _Parts:
    """Puts a stream's messages together: one image when all of its kinds are in."""

    def __init__(self, sensor: str, kinds: Sequence[Kind]) -> None:
        self._sensor = sensor  # of messages that name none
        self._kinds = kinds
        self._parts: dict[str, dict[Kind, Unpacked]] = {}
        self._status: dict[str, dict[str, Any]] = {}

    def take(self, data: str | bytes) -> Image | None:
        if isinstance(data, str):
            said = json.loads(data)
            self._status[said["sensor"]] = said
            return None
        part = unpack(data)
        name = part.sensor or self._sensor
        parts = self._parts.setdefault(name, {})
        parts[part.kind] = part
        if {each.sequence for each in parts.values()} != {part.sequence} or len(parts) < len(self._kinds):
            return None
        raw, restored, shear = parts["raw"], parts["restored"], parts.get("shear")
        return Image(
            raw.values, restored.values, raw.flags, raw.sequence, raw.timestamp, raw.noise_kpa, raw.resolution_mm,
            self._status.get(name, {}), name, shear.values if shear else None,
        )  # fmt: skip


class _Attempts:
    """What a stream knows from one connection to the next: when the last image came, and how long to wait."""

    def __init__(
        self, client: "Client", sensor: str | Sequence[str], rate_hz: float, patience_s: float | None, shear: bool
    ) -> None:
        self._url, self._patience_s = client.url, patience_s
        self._one = sensor if isinstance(sensor, str) else ""
        self._kinds = KINDS if shear else PRESSURES
        query: dict[str, object] = {"kinds": ",".join(self._kinds), "rate_hz": rate_hz}
        if isinstance(sensor, str):
            self._named, path = f"sensor {sensor!r}", f"/sensors/{quote(sensor, safe='')}/stream"
        else:
            self._named, path = f"sensors {', '.join(sensor)}", "/stream"
            query |= {"sensors": ",".join(sensor)}
        self.address = f"{client.url.replace('http', 'ws', 1)}/api/v1{path}?{urlencode(query)}"
        self.options: dict[str, Any] = {
            "additional_headers": client.headers,
            "compression": None,
            "max_queue": 4,
            "close_timeout": 1,
        }
        self._heard, self._wait = time.monotonic(), BACK_OFF_S[0]
        self._why = ""  # why there is no connection
        self._refused = ""  # why the service closed the last one

    def connected(self) -> None:
        """A connection begins, whose messages have no past."""
        self._parts, self._why = _Parts(self._one, self._kinds), ""

    def left(self) -> float | None:
        """How long (s) the next message may take; None: for ever."""
        return None if self._patience_s is None else max(0.0, self._heard + self._patience_s - time.monotonic())

    def take(self, data: str | bytes) -> Image | None:
        """The image that a message completes."""
        self._refused = ""  # only now: a refusal comes when it is connected, too
        image = self._parts.take(data)
        if image is not None:
            self._heard, self._wait = time.monotonic(), BACK_OFF_S[0]
        return image

    def failed(self, error: Exception) -> float:
        """How long to wait (s) for the next attempt after an error; TactileError where there is to be none."""
        if isinstance(error, ConnectionClosed) and error.rcvd is not None:
            self._refused = error.rcvd.reason
            if error.rcvd.code in REFUSED:
                raise TactileError(f"{self._url}: {self._refused}") from error
        elif isinstance(error, InvalidURI):
            raise TactileError(f"{self._url}: {error}") from error
        elif not isinstance(error, TimeoutError | ConnectionClosed):
            self._why = f"{getattr(error, 'strerror', None) or error}: is the service running?"
        why = f": {why}" if (why := self._why or self._refused) else ""
        if self.left() == 0:
            raise TactileError(f"{self._named} at {self._url}: no image for {self._patience_s} s{why}") from error
        if self._wait == BACK_OFF_S[0]:
            LOG.warning("%s at %s: no connection%s: trying again", self._named, self._url, why)
        wait, self._wait = self._wait, min(2 * self._wait, BACK_OFF_S[1])
        return wait


class Client:
    """Talks to one service; every method raises TactileError with the service's own words where it refuses."""

    def __init__(self, url: str, token: str | None = None) -> None:
        self.url = url
        self.headers = {"Authorization": f"Bearer {token}"} if token else {}

    def sensors(self) -> list[dict[str, Any]]:
        """Every sensor and how it is doing."""
        found: list[dict[str, Any]] = self._ask("GET", "/sensors")["sensors"]
        return found

    def set_method(self, sensor: str, method: str) -> None:
        """Restore by `method` from the next frame on."""
        self._ask("PUT", f"/sensors/{quote(sensor, safe='')}/method", {"method": method})

    def tare(self, sensor: str) -> None:
        """Take the mean of the next frames as the unloaded array."""
        self._ask("POST", f"/sensors/{quote(sensor, safe='')}/tare")

    def stream(
        self,
        sensor: str | Sequence[str],
        rate_hz: float = 0.0,
        patience_s: float | None = None,
        shear: bool = False,
    ) -> Iterator[Image]:
        """The newest images of a sensor, or of several, as they come, for ever; reconnects by itself.

        At most `rate_hz` a second (0: every frame) of each; with `shear`, which the skin must feel. TactileError
        if no image comes for `patience_s` (None: it waits), or if the service refuses; one stream too many, of
        this client (4429) or of all (4503), is no refusal: it waits for a place. What it waits for is logged once.
        """
        attempts = _Attempts(self, sensor, rate_hz, patience_s, shear)
        while True:
            try:
                with connect_sync(attempts.address, **attempts.options) as socket:
                    attempts.connected()
                    while True:
                        image = attempts.take(socket.recv(timeout=attempts.left()))
                        if image is not None:
                            yield image
            except LOST as error:
                time.sleep(attempts.failed(error))

    async def astream(
        self,
        sensor: str | Sequence[str],
        rate_hz: float = 0.0,
        patience_s: float | None = None,
        shear: bool = False,
    ) -> AsyncIterator[Image]:
        """The same as `stream`, for asyncio."""
        attempts = _Attempts(self, sensor, rate_hz, patience_s, shear)
        while True:
            try:
                async with connect_async(attempts.address, **attempts.options) as socket:
                    attempts.connected()
                    while True:
                        image = attempts.take(await asyncio.wait_for(socket.recv(), attempts.left()))
                        if image is not None:
                            yield image
            except LOST as error:
                await asyncio.sleep(attempts.failed(error))

    def _ask(self, verb: str, path: str, body: object = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        headers = self.headers | ({"Content-Type": "application/json"} if data else {})
        request = Request(f"{self.url}/api/v1{path}", data, headers, method=verb)
        try:
            with urlopen(request, timeout=ANSWER_S) as answer:  # connect() lets http and https in only
                return json.loads(answer.read() or b"null")
        except HTTPError as error:
            raise TactileError(f"{self.url}: {_detail(error)}") from error
        except (URLError, TimeoutError) as error:
            raise TactileError(
                f"{self.url}: {getattr(error, 'reason', error)}: is the service running?"
            ) from error


def _detail(error: HTTPError) -> str:
    """What the service says of an error."""
    try:
        return str(json.loads(error.read())["detail"])
    except (ValueError, KeyError, TypeError):
        return f"HTTP {error.code}"
