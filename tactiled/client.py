"""A client of the service: live images as numpy arrays, reconnecting; and the few things one asks of it.

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
from urllib.parse import parse_qs, quote, urlencode, urlsplit
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
QUIET = logging.getLogger(f"{__name__}.websockets")  # what it has to say of a connection that ends, LOG says
QUIET.setLevel(logging.CRITICAL)
ANSWER_S = 10.0  # that the service may take to answer, or to let a stream in
LAST_S = 0.1  # that an attempt to connect has when patience is at its end
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before the next attempt to connect
LONGEST_S = 1e6  # of patience
FRESH_S = 0.1  # that an image may have waited for the loop; a newer one may take as long to come
MISSED_S = 1.0  # without an image that was asked for, until the log says in what state its sensor is
WAITING = 1024  # messages; a loop that pauses is told each sensor's state once a second, and sent nothing else
LOST = OSError, WebSocketException  # TimeoutError is an OSError
TOO_MANY = 4429  # of this client: a place may come free
REFUSED = set(range(4400, 4500)) - {TOO_MANY}  # close codes that another attempt will meet again


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One frame, raw and restored, and its shear if that was asked for."""

    raw: NDArray[np.float32]  # kPa, (rows, columns); one row where the layout is no grid; NaN: unknown
    restored: NDArray[np.float32]  # kPa
    flags: NDArray[np.uint8]  # of raw's shape: 1 missing | 2 bad | 4 dead | 8 saturated
    sequence: int
    timestamp: float  # s, Unix, of the frame's first CAN message
    noise_kpa: float
    resolution_mm: float
    status: dict[str, Any]  # what the stream said last: state, method, ran, loss, warnings, ...
    sensor: str
    shear: NDArray[np.float32] | None = None  # counts along x and y, (2, rows, columns); NaN: unknown


def connect(url: str, token: str | None = None, ssl_context: ssl.SSLContext | None = None) -> "Client":
    """A client of the service at `url`, which may end in `?token=...`; nothing is sent yet.

    `ssl_context` says what an https service must show; by default a certificate that this machine trusts.
    ConfigError names what cannot be meant.
    """
    return Client(url, token, ssl_context)


def _address(url: str) -> tuple[str, list[str]]:
    """The address without what follows it, and the tokens that do."""
    shown = url.partition("?")[0] if isinstance(url, str) else url  # a token is not shown
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
        host.encode("idna")
        plain = url.isascii() and url.isprintable() and " " not in url and "@" not in parts.netloc
        if parts.scheme not in ("http", "https") or not host or parts.port == 0 or not plain:
            raise ValueError
    except (ValueError, TypeError, AttributeError):
        raise ConfigError(f"url = {shown!r}: give the service's address, such as http://127.0.0.1:8000") from None
    query = parse_qs(parts.query, keep_blank_values=True)
    tokens = query.pop("token", [])
    if query or parts.fragment or len(tokens) > 1:
        more = ", ".join(query) or (f"#{parts.fragment}" if parts.fragment else "second")
        raise ConfigError(f"url = {shown!r}: one ?token=... may follow it, no {more}")
    return f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}", tokens


def _names(key: str, given: object) -> list[str]:
    """The sensors that an argument names; ConfigError where it names none."""
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, Iterable) else []
    if not names or not all(isinstance(name, str) and name and "," not in name for name in names):
        raise ConfigError(f"{key} = {given!r}: give a sensor's name, or several")
    return names


def _patience(given: object) -> float | None:
    """The seconds given; ConfigError where they are none."""
    if given is None or (isinstance(given, Real) and 0 < float(given) <= LONGEST_S):
        return None if given is None else float(given)
    raise ConfigError(f"patience_s = {given!r}: give up to {LONGEST_S:g} s, or None")


class _Inbox:
    """What of one connection's messages is for the loop: the newest image of each sensor that it has not had.

    Images are asked for when the loop asks for one, so that they are the newest. Of several sensors one has its
    turn, and the others are asked again each time; where the loop was away for long, what came meanwhile waits
    FRESH_S for a newer one of the same sensor, and is itself the newest if none comes.
    """

    def __init__(self, kinds: dict[str, Sequence[Kind]]) -> None:
        self._kinds = kinds
        self.status: dict[str, dict[str, Any]] = {}
        self.asked: dict[str, float] = {}  # sensors whose next image is asked for, and since when (s)
        self._parts: dict[str, dict[Kind, Unpacked]] = {name: {} for name in kinds}
        self._images: dict[str, Image] = {}  # the first to be handed out first
        self._came: set[str] = set()  # sensors whose image did not wait for the loop
        self._old: set[str] = set()  # sensors whose image may have waited for long, or may when it comes
        self._newer_by = self._gave = self._called = time.monotonic()

    def wanted(self) -> None:
        """The loop asks for an image."""
        self._called = time.monotonic()
        if self._called - self._gave > FRESH_S:
            self._old = self.asked.keys() | self._images.keys()
            self._newer_by = self._called + FRESH_S
        self._came.clear()

    def asks(self) -> list[str]:
        """The messages that ask for what is not asked for, but of what came in time."""
        names = [name for name in self._kinds if name not in self.asked and name not in self._came]
        self.asked |= dict.fromkeys(names, time.monotonic())
        return [json.dumps({"type": "next", "sensor": name}) for name in names]

    def waits(self) -> float:
        """How long (s) to wait for a further message before there is one to hand out; inf: there is none."""
        left = self._newer_by - time.monotonic() if self._old & self._images.keys() else 0.0
        return max(0.0, left) if self._images else math.inf

    def ready(self) -> Image | None:
        """The image to hand out."""
        if self.waits():
            return None
        self._gave = time.monotonic()
        return self._images.pop(next(iter(self._images)))

    def take(self, data: str | bytes) -> str | None:
        """Take a message; the sensor whose image it completes."""
        if isinstance(data, str):
            said = json.loads(data)
            self.status[said["sensor"]] = said
            return None
        part = unpack(data)
        name, parts = part.sensor, self._parts[part.sensor]
        parts[part.kind] = part
        if {each.sequence for each in parts.values()} != {part.sequence} or len(parts) < len(self._kinds[name]):
            return None
        asked = self.asked.pop(name, 0.0)
        if name not in self.status:
            return None  # of a service before 0.4.2, which tells it afterwards
        if asked >= self._called:
            self._came.add(name)
            self._old.discard(name)
        raw, shear = parts["raw"], parts.get("shear")
        self._images[name] = Image(
            raw.values, parts["restored"].values, raw.flags.reshape(raw.values.shape), raw.sequence, raw.timestamp,
            raw.noise_kpa, raw.resolution_mm, self.status[name], name, shear.values if shear else None,
        )  # fmt: skip
        return name


class _Stream:
    """What a stream knows from one connection to the next: what it is for, what it waits for and how long."""

    def __init__(
        self,
        client: "Client",
        sensor: str | Sequence[str],
        rate_hz: float,
        patience_s: float | None,
        shear: bool | str | Sequence[str],
    ) -> None:
        names = _names("sensor", sensor)
        felt = [] if shear is False else names if shear is True else _names("shear", shear)
        self._url, self._patience_s = client.url, _patience(patience_s)
        self._named = f"sensor {sensor!r}" if isinstance(sensor, str) else f"sensors {', '.join(names)}"
        self._kinds: dict[str, Sequence[Kind]] = {
            name: (*PRESSURES, "shear") if name in felt else PRESSURES for name in names
        }
        query = {"sensors": ",".join(names), "rate_hz": rate_hz, "flow": "credit"}
        query |= {"shear": ",".join(felt)} if felt else {}
        self.address = f"ws{client.url.removeprefix('http')}/api/v1/stream?{urlencode(query)}"
        self._options = {
            "additional_headers": client.headers,
            "compression": None,
            "max_queue": WAITING,
            "close_timeout": 1,
            "logger": QUIET,
        } | ({"ssl": client.ssl_context} if client.ssl_context else {})
        self._wait = BACK_OFF_S[0]
        self._refused = ""  # why the last connection ended
        self._logged: set[str] = set()  # sensors, and why there was no connection
        self.connected()
        self.wanted()

    def options(self) -> dict[str, Any]:
        """How to connect now."""
        return self._options | {"open_timeout": min(ANSWER_S, max(LAST_S, self._left()))}

    def connected(self) -> None:
        """A connection begins, whose messages have no past."""
        self._inbox, self._why = _Inbox(self._kinds), ""  # why there is no connection

    def wanted(self) -> None:
        """The loop asks for an image: patience begins anew."""
        self._inbox.wanted()
        self._since = time.monotonic()

    def asks(self) -> list[str]:
        """The messages to send before the next is waited for."""
        return self._inbox.asks()

    def ready(self) -> Image | None:
        """The image to hand out."""
        return self._inbox.ready()

    def waits(self) -> float | None:
        """How long (s) the next message may take, None: for ever; TactileError where patience is at its end."""
        if (wait := self._inbox.waits()) == math.inf and (wait := self._left()) == 0:
            raise self._over()
        return None if wait == math.inf else wait

    def take(self, data: str | bytes) -> None:
        """Take a message; TactileError where it is none of this version's."""
        self._refused = ""  # only now: a refusal comes when it is connected, too
        try:
            name = self._inbox.take(data)
        except (ValueError, LookupError, TypeError) as error:
            raise TactileError(f"{self._url}: no message of this version of tactiled: {error}") from error
        if name is not None:
            self._wait = BACK_OFF_S[0]
            self._logged &= self._kinds.keys() - {name}
        elif isinstance(data, str):
            for missed, why in self._missed(MISSED_S).items():
                self._log(missed, f"no image: {why}: waiting")

    def failed(self, error: Exception) -> float:
        """How long to wait (s) for the next attempt after an error; TactileError where there is to be none."""
        if isinstance(error, ssl.SSLCertVerificationError):
            raise TactileError(f"{self._url}: {_why(error)}") from error
        if isinstance(error, ConnectionClosed):
            self._refused = _ended(error)
            if error.rcvd is not None and error.rcvd.code in REFUSED:
                raise TactileError(f"{self._url}: {error.rcvd.reason}") from error
        elif not isinstance(error, TimeoutError) or not (self._why or self._refused):
            self._why = _why(error)
        why = self._why or self._refused
        if (left := self._left()) == 0:
            raise self._over() from error
        self._log(why, f"no connection: {why}: trying again")
        wait, self._wait = min(self._wait, left), min(2 * self._wait, BACK_OFF_S[1])
        return wait

    def _left(self) -> float:
        """How long (s) patience lasts."""
        longest = math.inf if self._patience_s is None else self._patience_s
        return max(0.0, self._since + longest - time.monotonic())

    def _over(self) -> TactileError:
        why = self._why or self._refused or ", ".join(self._missed(0.0).values())
        return TactileError(
            f"{self._named} at {self._url}: no image for {self._patience_s} s{f': {why}' if why else ''}"
        )

    def _missed(self, seconds: float) -> dict[str, str]:
        """The sensors that are not live and owe an image for so long, each with what was told of it."""
        since, status = time.monotonic() - seconds, self._inbox.status
        return {
            name: f"{name} is {status[name]['state']}: {status[name]['detail']}"
            for name, at in self._inbox.asked.items()
            if at <= since and name in status and status[name]["state"] != "live"
        }

    def _log(self, once: str, text: str) -> None:
        if once not in self._logged:
            self._logged.add(once)
            LOG.warning("%s at %s: %s", self._named, self._url, text)


def _read(stream: _Stream) -> Generator[Image, None, None]:
    stream.wanted()
    while True:
        try:
            with connect_sync(stream.address, **stream.options()) as socket:
                stream.connected()
                while True:
                    for ask in stream.asks():
                        socket.send(ask)
                    try:
                        stream.take(socket.recv(timeout=stream.waits()))
                    except TimeoutError:
                        if (image := stream.ready()) is not None:
                            yield image
                            stream.wanted()
        except LOST as error:
            time.sleep(stream.failed(error))


async def _aread(stream: _Stream) -> AsyncGenerator[Image, None]:
    stream.wanted()
    while True:
        try:
            async with connect_async(stream.address, **stream.options()) as socket:
                stream.connected()
                while True:
                    for ask in stream.asks():
                        await socket.send(ask)
                    try:
                        async with asyncio.timeout(stream.waits()):
                            data = await socket.recv()
                        stream.take(data)
                    except TimeoutError:
                        if (image := stream.ready()) is not None:
                            yield image
                            stream.wanted()
        except LOST as error:
            await asyncio.sleep(stream.failed(error))


class Client:
    """Talks to one service; every method raises TactileError with the service's own words where it refuses."""

    def __init__(self, url: str, token: str | None = None, ssl_context: ssl.SSLContext | None = None) -> None:
        self.url, tokens = _address(url)
        if token and tokens:
            raise ConfigError("token: given twice, in url, too")
        shown = token or "".join(tokens)
        if not isinstance(shown, str) or not shown.isascii() or not shown.isprintable():
            raise ConfigError("token: give printable ASCII characters")
        if ssl_context is not None and not self.url.startswith("https"):
            raise ConfigError(f"ssl_context: url = {self.url!r} is not https")
        self.ssl_context = ssl_context
        self.headers = {"Authorization": f"Bearer {shown}"} if shown else {}

    def sensors(self) -> list[dict[str, Any]]:
        """Every sensor and how it is doing."""
        answer = self._ask("GET", "/sensors")
        try:
            found: list[dict[str, Any]] = answer["sensors"]
        except (TypeError, LookupError) as error:
            raise TactileError(f"{self.url}: no service of tactiled: it names no sensors") from error
        return found

    def set_method(self, sensor: str, method: str) -> None:
        """Restore by `method` from the next frame on."""
        self._ask("PUT", f"/sensors/{_quoted(sensor)}/method", {"method": str(method)})

    def tare(self, sensor: str, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array.

        LoadedError, whose `seen` says why, where the newest frames show a load, unless it is by `force`.
        """
        self._ask("POST", f"/sensors/{_quoted(sensor)}/tare{'?force=true' if force else ''}")

    def stream(
        self,
        sensor: str | Sequence[str],
        rate_hz: float = 0.0,
        patience_s: float | None = None,
        shear: bool | str | Sequence[str] = False,
    ) -> Generator[Image, None, None]:
        """The newest images of a sensor, or of several, as they come, for ever; reconnects by itself.

        Each is the newest there is when the loop asks for it: a loop slower than the sensor misses images and sees
        none that is old. At most `rate_hz` a second (0: every frame) of each; with `shear`, of all sensors or of
        those named, whose skin must feel it. TactileError if the loop waits for an image for `patience_s` (None:
        for ever), or if the service refuses; one stream too many, of this client (4429) or of all (4503), is no
        refusal: it waits for a place. What it waits for is logged once.
        """
        images = _read(_Stream(self, sensor, rate_hz, patience_s, shear))
        _KEPT.add(images)
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

    def _ask(self, verb: str, path: str, body: object = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        headers = self.headers | ({"Content-Type": "application/json"} if data else {})
        request = Request(f"{self.url}/api/v1{path}", data, headers, method=verb)
        try:
            with urlopen(request, timeout=ANSWER_S, context=self.ssl_context) as answer:  # http and https alone
                return json.loads(answer.read() or b"null")
        except HTTPError as error:
            raise _refusal(self.url, error) from error
        except (OSError, HTTPException, ValueError) as error:
            raise TactileError(f"{self.url}: {_why(error)}") from error


_KEPT: WeakSet[Generator[Image, None, None]] = WeakSet()


@atexit.register
def _end() -> None:
    """Close the streams that a program has kept, while the threads that this waits for still run."""
    for images in list(_KEPT):
        with suppress(ValueError):  # a thread is in it
            images.close()


def _quoted(sensor: str) -> str:
    """A sensor's name in an address."""
    if not isinstance(sensor, str) or not sensor:
        raise ConfigError(f"sensor = {sensor!r}: give a sensor's name")
    return quote(sensor, safe="")


def _why(error: Exception) -> str:
    """What an error says, in a line."""
    if isinstance(error, URLError) and isinstance(error.reason, Exception):
        return _why(error.reason)
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    if isinstance(error, json.JSONDecodeError):
        return f"no service of tactiled: its answer is no JSON: {text}"
    return f"{text}: is the service running?" if isinstance(error, ConnectionRefusedError) else text


def _ended(error: ConnectionClosed) -> str:
    """Why a connection ended."""
    if error.rcvd is not None:
        return f"{error.rcvd.reason or 'closed'} ({error.rcvd.code})"
    return error.sent.reason if error.sent is not None else "the connection broke"


def _refusal(url: str, error: HTTPError) -> TactileError:
    """What the service says of an error."""
    try:
        problem = json.loads(error.read())
        text = f"{url}: {problem['detail']}"
        return LoadedError(text, problem["seen"]) if problem.get("code") == "loaded" else TactileError(text)
    except (ValueError, KeyError, TypeError, AttributeError, OSError, HTTPException):
        return TactileError(f"{url}: HTTP {error.code}")
