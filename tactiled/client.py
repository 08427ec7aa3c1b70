"""A client of the service: live images as numpy arrays, reconnecting; and the few things one asks of it.

from tactiled.client import connect

for image in connect("http://127.0.0.1:8000").stream("palm"):
    print(image.sequence, image.restored.max(), "kPa")
"""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Iterator
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
from tactiled.web.wire import Unpacked, unpack

ANSWER_S = 10.0  # that the service may take to answer
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before the next attempt to connect
REFUSED = range(4400, 4500)  # close codes that another attempt will meet again


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One frame, raw and restored."""

    raw: NDArray[np.float32]  # kPa, (rows, columns); one row where the layout is no grid; NaN: unknown
    restored: NDArray[np.float32]  # kPa
    flags: NDArray[np.uint8]  # a raw taxel's 1 missing | 2 bad | 4 dead | 8 saturated
    sequence: int
    timestamp: float  # s, Unix, of the frame's first CAN message
    noise_kpa: float
    resolution_mm: float
    status: dict[str, Any] = field(default_factory=dict)  # what the stream said last: state, loss, warnings, ...


def connect(url: str, token: str | None = None) -> "Client":
    """A client of the service at `url`; nothing is sent yet. ConfigError where that is no http address."""
    if urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).hostname:
        raise ConfigError(f"url = {url!r}: give the service's address, such as http://127.0.0.1:8000")
    return Client(url.rstrip("/"), token)


class _Pairs:
    """Puts a stream's messages together: one image when both of its kinds are in."""

    def __init__(self) -> None:
        self._raw: Unpacked | None = None
        self._status: dict[str, Any] = {}

    def take(self, data: str | bytes) -> Image | None:
        if isinstance(data, str):
            self._status = json.loads(data)
            return None
        part = unpack(data)
        if part.kind == "raw":
            self._raw = part
            return None
        raw = self._raw
        if raw is None or raw.sequence != part.sequence:
            return None
        return Image(
            raw.values, part.values, raw.flags, raw.sequence, raw.timestamp, raw.noise_kpa, raw.resolution_mm,
            self._status,
        )  # fmt: skip


class Client:
    """Talks to one service; every method raises TactileError with the service's own words where it refuses."""

    def __init__(self, url: str, token: str | None = None) -> None:
        self.url = url
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}

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

    def stream(self, sensor: str, rate_hz: float = 0.0, patience_s: float | None = None) -> Iterator[Image]:
        """The newest images as they come, for ever; reconnects by itself.

        At most `rate_hz` a second (0: every frame). TactileError if no image comes for `patience_s`
        (None: it waits), or if the service refuses.
        """
        address, wait = self._address(sensor, rate_hz), BACK_OFF_S[0]
        heard = time.monotonic()
        while True:
            try:
                with connect_sync(
                    address, additional_headers=self._headers, compression=None, max_queue=4, close_timeout=1
                ) as socket:
                    pairs = _Pairs()
                    while True:
                        left = None if patience_s is None else heard + patience_s - time.monotonic()
                        image = pairs.take(socket.recv(timeout=left))
                        if image is not None:
                            heard, wait = time.monotonic(), BACK_OFF_S[0]
                            yield image
            except TimeoutError as error:
                raise self._late(sensor, patience_s) from error
            except (OSError, ConnectionClosed, InvalidHandshake, InvalidURI) as error:
                self._judge(error)
            if patience_s is not None and time.monotonic() - heard > patience_s:
                raise self._late(sensor, patience_s)
            time.sleep(wait)
            wait = min(2 * wait, BACK_OFF_S[1])

    async def astream(
        self, sensor: str, rate_hz: float = 0.0, patience_s: float | None = None
    ) -> AsyncIterator[Image]:
        """The same as `stream`, for asyncio."""
        address, wait = self._address(sensor, rate_hz), BACK_OFF_S[0]
        heard = time.monotonic()
        while True:
            try:
                async with connect_async(
                    address, additional_headers=self._headers, compression=None, max_queue=4, close_timeout=1
                ) as socket:
                    pairs = _Pairs()
                    while True:
                        left = None if patience_s is None else heard + patience_s - time.monotonic()
                        image = pairs.take(await asyncio.wait_for(socket.recv(), left))
                        if image is not None:
                            heard, wait = time.monotonic(), BACK_OFF_S[0]
                            yield image
            except TimeoutError as error:
                raise self._late(sensor, patience_s) from error
            except (OSError, ConnectionClosed, InvalidHandshake, InvalidURI) as error:
                self._judge(error)
            if patience_s is not None and time.monotonic() - heard > patience_s:
                raise self._late(sensor, patience_s)
            await asyncio.sleep(wait)
            wait = min(2 * wait, BACK_OFF_S[1])

    def _address(self, sensor: str, rate_hz: float) -> str:
        query = urlencode({"kinds": "raw,restored", "rate_hz": rate_hz})
        return f"{self.url.replace('http', 'ws', 1)}/api/v1/sensors/{quote(sensor, safe='')}/stream?{query}"

    def _late(self, sensor: str, patience_s: float | None) -> TactileError:
        return TactileError(f"sensor {sensor!r} at {self.url}: no image for {patience_s} s")

    def _judge(self, error: Exception) -> None:
        """Let an error pass that may be over at the next attempt; TactileError for any other."""
        if isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code in REFUSED:
            raise TactileError(f"{self.url}: {error.rcvd.reason}") from error
        if isinstance(error, InvalidURI):
            raise TactileError(f"{self.url}: {error}") from error

    def _ask(self, verb: str, path: str, body: object = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        headers = self._headers | ({"Content-Type": "application/json"} if data else {})
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
