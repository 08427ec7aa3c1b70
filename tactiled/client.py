"""A client of the service: live images as numpy arrays, reconnecting; and a few requests.

import tactiled

for image in tactiled.connect("http://127.0.0.1:8000").stream("palm"):
    print(image.sequence, image.restored.max(), "kPa")
"""

import asyncio
import atexit
import json
import logging
import math
import ssl
import time
from collections.abc import AsyncGenerator, Generator, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from http.client import HTTPException
from numbers import Real
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import parse_qsl, quote, urlencode, urlsplit
from urllib.request import Request, urlopen
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect as connect_sync

from tactiled.errors import ConfigError, LoadedError, TactileError
from tactiled.wire import PRESSURES, Kind, Unpacked, unpack

LOG = logging.getLogger(__name__)
WEBSOCKETS_LOG = logging.getLogger(f"{__name__}.websockets")
WEBSOCKETS_LOG.setLevel(logging.CRITICAL)  # LOG has why a connection ended
ANSWER_S = 10.0  # that the service may take to answer, or to accept a stream
MIN_CONNECT_S = 0.1  # that an attempt to connect has when `patience_s` is nearly over
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before the next attempt to connect
MAX_PATIENCE_S = 1e6
FRESH_S = 0.1  # a shorter pause of the loop makes no image old; a newer image may take as long to come
LOG_AFTER_S = 1.0  # without a requested image, the log has the state of its sensor
MAX_QUEUE = 1024  # messages: a loop that pauses gets one status a second of each sensor, and no image
CONNECTION_ERRORS = OSError, WebSocketException  # TimeoutError is an OSError
TOO_MANY = 4429  # streams of this client: a place may become free
REFUSED = set(range(4400, 4500)) - {TOO_MANY}  # close codes that another attempt meets again


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One frame, raw and restored, and its shear if requested."""

    raw: NDArray[np.float32]  # kPa, (rows, columns); one row where the layout is no grid; NaN: unknown
    restored: NDArray[np.float32]  # kPa
    flags: NDArray[np.uint8]  # of raw's shape: 1 missing | 2 bad | 4 dead | 8 saturated
    sequence: int
    timestamp: float  # s, Unix, of the frame's first CAN message
    noise_kpa: float
    resolution_mm: float
    status: dict[str, Any]  # the newest of the stream: state, method, ran, loss, warnings, ...
    sensor: str
    shear: NDArray[np.float32] | None = None  # counts along x and y, (2, rows, columns); NaN: unknown


def connect(url: str, token: str | None = None, ssl_context: ssl.SSLContext | None = None) -> "Client":
    """A client of the service at `url`, which may end in `?token=...`; sends nothing yet.

    `ssl_context` decides which certificate of an https service is trusted; by default those of this machine.
    ConfigError names a wrong argument.
    """
    return Client(url, token, ssl_context)


def _parse_url(url: str) -> tuple[str, str]:
    """The address without its query, and the token in that."""
    try:
        parts = urlsplit(url)
        query = parse_qsl(parts.query, keep_blank_values=True)
        known = [name for name, _ in query] in ([], ["token"]) and not parts.fragment and "@" not in parts.netloc
        text = url.isascii() and url.isprintable() and " " not in url
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.port == 0 or not (known and text):
            raise ValueError
    except (ValueError, TypeError, AttributeError):
        shown = url.partition("?")[0] if isinstance(url, str) else url  # without a token
        raise ConfigError(
            f"url = {shown!r}: give the service's address, such as http://127.0.0.1:8000, with ?token=... at most"
        ) from None
    return f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}", query[0][1] if query else ""


def _parse_names(key: str, value: object) -> list[str]:
    """The sensors that an argument names; ConfigError where it names none."""
    names = [value] if isinstance(value, str) else list(value) if isinstance(value, Iterable) else []
    if not names or not all(isinstance(name, str) and name and "," not in name for name in names):
        raise ConfigError(f"{key} = {value!r}: give a sensor's name, or several")
    return names


def _parse_patience(value: object) -> float:
    """An argument in seconds, None as inf; ConfigError where it is no time."""
    if value is None:
        return math.inf
    if isinstance(value, Real) and 0 < float(value) <= MAX_PATIENCE_S:
        return float(value)
    raise ConfigError(f"patience_s = {value!r}: give up to {MAX_PATIENCE_S:g} s, or None")


class _Inbox:
    """The messages of one connection: the newest image of each sensor that the loop has not had.

    An image is requested when the loop asks for one, so that it is the newest. Of several sensors each has its
    turn, and the others wait. Where the loop was away, an image that was requested before is old: it waits FRESH_S
    for a newer one of its sensor, and is handed out if none comes.
    """

    def __init__(self, kinds: dict[str, Sequence[Kind]]) -> None:
        self._kinds = kinds
        self.status: dict[str, dict[str, Any]] = {}
        self.requested: dict[str, float] = {}  # time (s) at which each sensor's next image was requested
        self._parts: dict[str, dict[Kind, Unpacked]] = {name: {} for name in kinds}
        self._images: dict[str, tuple[Image, float]] = {}  # with the time of the request, in the order of turns
        self._asked = self._handed_out = self._fresh_from = time.monotonic()

    def ask(self) -> None:
        """The loop asks for an image."""
        self._asked = time.monotonic()
        if self._asked - self._handed_out > FRESH_S:
            self._fresh_from = self._asked

    def requests(self) -> list[str]:
        """The messages that request images, none of a sensor whose image was requested after `ask`."""
        waiting = {name for name, (_, requested) in self._images.items() if requested >= self._asked}
        names = [name for name in self._kinds if name not in self.requested and name not in waiting]
        self.requested |= dict.fromkeys(names, time.monotonic())
        return [json.dumps({"type": "next", "sensor": name}) for name in names]

    def wait_s(self) -> float:
        """How long to wait for another message before `pop`; inf: there is no image."""
        if not self._images:
            return math.inf
        _, requested = next(iter(self._images.values()))
        return max(0.0, self._fresh_from + FRESH_S - time.monotonic()) if requested < self._fresh_from else 0.0

    def pop(self) -> Image | None:
        """The image to hand out, if there is one."""
        if self.wait_s():
            return None
        self._handed_out = time.monotonic()
        image, _ = self._images.pop(next(iter(self._images)))
        return image

    def take(self, data: str | bytes) -> str | None:
        """Take a message; the sensor whose image it completes."""
        if isinstance(data, str):
            status = json.loads(data)
            self.status[status["sensor"]] = status
            return None
        part = unpack(data)
        name, parts = part.sensor, self._parts[part.sensor]
        parts[part.kind] = part
        if {each.sequence for each in parts.values()} != {part.sequence} or len(parts) < len(self._kinds[name]):
            return None
        raw, shear = parts["raw"], parts.get("shear")
        image = Image(
            raw.values, parts["restored"].values, raw.flags.reshape(raw.values.shape), raw.sequence, raw.timestamp,
            raw.noise_kpa, raw.resolution_mm, self.status[name], name, shear.values if shear else None,
        )  # fmt: skip
        self._images[name] = image, self.requested.pop(name, 0.0)
        return name


class _Stream:
    """A stream from one connection to the next: its address, and how long it still waits."""

    def __init__(
        self,
        client: "Client",
        sensor: str | Sequence[str],
        rate_hz: float,
        patience_s: float | None,
        shear: bool | str | Sequence[str],
    ) -> None:
        names = _parse_names("sensor", sensor)
        sheared = [] if shear is False else names if shear is True else _parse_names("shear", shear)
        self._url, self._patience_s = client.url, _parse_patience(patience_s)
        self._title = f"sensor {sensor!r}" if isinstance(sensor, str) else f"sensors {', '.join(names)}"
        self._kinds: dict[str, Sequence[Kind]] = {
            name: (*PRESSURES, "shear") if name in sheared else PRESSURES for name in names
        }
        query = {"sensors": ",".join(names), "rate_hz": rate_hz, "flow": "credit"}
        query |= {"shear": ",".join(sheared)} if sheared else {}
        self.address = f"ws{client.url.removeprefix('http')}/api/v1/stream?{urlencode(query)}"
        self._options: dict[str, Any] = {"additional_headers": client.headers, "compression": None}
        self._options |= {"max_queue": MAX_QUEUE, "close_timeout": 1, "logger": WEBSOCKETS_LOG}
        self._options |= {"ssl": client.ssl_context} if client.ssl_context else {}
        self._back_off_s = BACK_OFF_S[0]
        self._error = ""  # of the newest connection, unless a message came
        self._logged: set[str] = set()  # sensors and errors
        self.connected()
        self.ask()

    def options(self) -> dict[str, Any]:
        """How to connect now."""
        return self._options | {"open_timeout": min(ANSWER_S, max(MIN_CONNECT_S, self._patience_left_s()))}

    def connected(self) -> None:
        """A connection begins."""
        self.inbox = _Inbox(self._kinds)

    def ask(self) -> None:
        """The loop asks for an image: patience begins anew."""
        self.inbox.ask()
        self._since = time.monotonic()

    def wait_s(self) -> float | None:
        """How long the next message may take, None: for ever; TactileError where patience is over."""
        wait = self.inbox.wait_s()
        if wait == math.inf:
            wait = self._patience_left_s()
            if wait == 0:
                raise self._timed_out()
        return None if wait == math.inf else wait

    def take(self, data: str | bytes) -> None:
        """Take a message; TactileError where it is none of this version's."""
        self._error = ""
        try:
            name = self.inbox.take(data)
        except (ValueError, LookupError, TypeError) as error:
            raise TactileError(f"{self._url}: no message of this version of tactiled: {error}") from error
        if name is not None:
            self._back_off_s = BACK_OFF_S[0]
            self._logged &= self._kinds.keys() - {name}
        elif isinstance(data, str):
            for missing, why in self._missing(LOG_AFTER_S).items():
                self._log(missing, f"no image: {why}: waiting")

    def failed(self, error: Exception) -> float:
        """How long to wait (s) after an error before the next attempt; TactileError where there is to be none."""
        if isinstance(error, ssl.SSLCertVerificationError):
            raise TactileError(f"{self._url}: {_describe(error)}") from error
        if isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code in REFUSED:
            raise TactileError(f"{self._url}: {error.rcvd.reason}") from error
        if not isinstance(error, TimeoutError) or not self._error:
            self._error = _describe(error)
        left = self._patience_left_s()
        if left == 0:
            raise self._timed_out() from error
        self._log(self._error, f"no connection: {self._error}: trying again")
        wait, self._back_off_s = min(self._back_off_s, left), min(2 * self._back_off_s, BACK_OFF_S[1])
        return wait

    def _patience_left_s(self) -> float:
        return max(0.0, self._since + self._patience_s - time.monotonic())

    def _timed_out(self) -> TactileError:
        why = self._error or ", ".join(self._missing(0.0).values())
        return TactileError(
            f"{self._title} at {self._url}: no image for {self._patience_s} s{f': {why}' if why else ''}"
        )

    def _missing(self, seconds: float) -> dict[str, str]:
        """The sensors that are not live and whose image was requested so long ago, each with its state."""
        since, status = time.monotonic() - seconds, self.inbox.status
        return {
            name: f"{name} is {status[name]['state']}: {status[name]['detail']}"
            for name, requested in self.inbox.requested.items()
            if requested <= since and name in status and status[name]["state"] != "live"
        }

    def _log(self, once: str, text: str) -> None:
        if once not in self._logged:
            self._logged.add(once)
            LOG.warning("%s at %s: %s", self._title, self._url, text)


def _read(stream: _Stream) -> Generator[Image, None, None]:
    stream.ask()
    while True:
        try:
            with connect_sync(stream.address, **stream.options()) as socket:
                stream.connected()
                while True:
                    for request in stream.inbox.requests():
                        socket.send(request)
                    try:
                        stream.take(socket.recv(timeout=stream.wait_s()))
                    except TimeoutError:
                        if (image := stream.inbox.pop()) is not None:
                            yield image
                            stream.ask()
        except CONNECTION_ERRORS as error:
            time.sleep(stream.failed(error))


async def _aread(stream: _Stream) -> AsyncGenerator[Image, None]:
    stream.ask()
    while True:
        try:
            async with connect_async(stream.address, **stream.options()) as socket:
                stream.connected()
                while True:
                    for request in stream.inbox.requests():
                        await socket.send(request)
                    try:
                        async with asyncio.timeout(stream.wait_s()):
                            data = await socket.recv()
                        stream.take(data)
                    except TimeoutError:
                        if (image := stream.inbox.pop()) is not None:
                            yield image
                            stream.ask()
        except CONNECTION_ERRORS as error:
            await asyncio.sleep(stream.failed(error))


class Client:
    """Talks to one service; every method raises TactileError with the service's message where it refuses."""

    def __init__(self, url: str, token: str | None = None, ssl_context: ssl.SSLContext | None = None) -> None:
        self.url, token_in_url = _parse_url(url)
        if token and token_in_url:
            raise ConfigError("token: given twice, in url, too")
        token = token or token_in_url
        if not isinstance(token, str) or not token.isascii() or not token.isprintable():
            raise ConfigError("token: give printable ASCII characters")
        if ssl_context is not None and not self.url.startswith("https"):
            raise ConfigError(f"ssl_context: url = {self.url!r} is not https")
        self.ssl_context = ssl_context
        self.headers = {"Authorization": f"Bearer {token}"} if token else {}

    def sensors(self) -> list[dict[str, Any]]:
        """Every sensor and its state."""
        answer = self._request("GET", "/sensors")
        try:
            sensors: list[dict[str, Any]] = answer["sensors"]
        except (TypeError, LookupError) as error:
            raise TactileError(f"{self.url}: no service of tactiled: it names no sensors") from error
        return sensors

    def set_method(self, sensor: str, method: str) -> None:
        """Restore by `method` from the next frame on."""
        self._request("PUT", f"/sensors/{_quoted(sensor)}/method", {"method": str(method)})

    def tare(self, sensor: str, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array.

        LoadedError, whose `seen` says why, where the newest frames show a load, unless it is by `force`.
        """
        self._request("POST", f"/sensors/{_quoted(sensor)}/tare{'?force=true' if force else ''}")

    def stream(
        self,
        sensor: str | Sequence[str],
        rate_hz: float = 0.0,
        patience_s: float | None = None,
        shear: bool | str | Sequence[str] = False,
    ) -> Generator[Image, None, None]:
        """The newest images of a sensor, or of several, as they come, for ever; reconnects by itself.

        Each is the newest there is when the loop asks for it: a loop slower than the sensor misses images and gets
        none that is old. At most `rate_hz` a second (0: every frame) of each; with `shear`, of all sensors or of
        those named, whose skin must sense it. TactileError if the loop waits for an image for `patience_s` (None:
        for ever), or if the service refuses; after one stream too many, of this client (4429) or of all (4503), it
        waits for a place. The log has once what it waits for.
        """
        images = _read(_Stream(self, sensor, rate_hz, patience_s, shear))
        _STREAMS.add(images)
        return images

    def astream(
        self,
        sensor: str | Sequence[str],
        rate_hz: float = 0.0,
        patience_s: float | None = None,
        shear: bool | str | Sequence[str] = False,
    ) -> AsyncGenerator[Image, None]:
        """The same as `stream`, for asyncio."""
        return _aread(_Stream(self, sensor, rate_hz, patience_s, shear))

    def _request(self, verb: str, path: str, body: object = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        headers = self.headers | ({"Content-Type": "application/json"} if data else {})
        request = Request(f"{self.url}/api/v1{path}", data, headers, method=verb)
        try:
            with urlopen(request, timeout=ANSWER_S, context=self.ssl_context) as answer:  # http or https
                return json.loads(answer.read() or b"null")
        except HTTPError as error:
            raise _refusal(self.url, error) from error
        except (OSError, HTTPException, ValueError) as error:
            raise TactileError(f"{self.url}: {_describe(error)}") from error


_STREAMS: WeakSet[Generator[Image, None, None]] = WeakSet()


@atexit.register
def _close_streams() -> None:
    """Close the streams that a program still has, while the threads that this waits for still run."""
    for images in list(_STREAMS):
        with suppress(ValueError):  # a thread is in it
            images.close()


def _quoted(sensor: str) -> str:
    """A sensor's name in an address."""
    if not isinstance(sensor, str) or not sensor:
        raise ConfigError(f"sensor = {sensor!r}: give a sensor's name")
    return quote(sensor, safe="")


def _describe(error: Exception) -> str:
    """An error in a line."""
    if isinstance(error, URLError) and isinstance(error.reason, Exception):
        return _describe(error.reason)
    if isinstance(error, ConnectionClosed):
        if error.rcvd is not None:
            return f"{error.rcvd.reason or 'closed'} ({error.rcvd.code})"
        return error.sent.reason if error.sent is not None else "the connection broke"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    if isinstance(error, json.JSONDecodeError):
        return f"no service of tactiled: its answer is no JSON: {text}"
    return f"{text}: is the service running?" if isinstance(error, ConnectionRefusedError) else text


def _refusal(url: str, error: HTTPError) -> TactileError:
    """The service's own message of an error."""
    try:
        problem = json.loads(error.read())
        text = f"{url}: {problem['detail']}"
        return LoadedError(text, problem["seen"]) if problem.get("code") == "loaded" else TactileError(text)
    except (ValueError, KeyError, TypeError, AttributeError, OSError, HTTPException):
        return TactileError(f"{url}: HTTP {error.code}")
