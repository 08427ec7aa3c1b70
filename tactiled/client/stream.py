"""A stream of live images, which goes on over one connection after the other."""

import asyncio
import json
import logging
import math
import ssl
import time
from collections.abc import AsyncGenerator, Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, NamedTuple
from urllib.error import URLError
from urllib.parse import urlencode

from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect as connect_sync

from tactiled.arrays import Flags, Floats32, Mask
from tactiled.client.display import html
from tactiled.errors import ConfigError, TactileError
from tactiled.units import COUNTS, FORCE_UNITS, PRESSURE, Unit
from tactiled.wire import KINDS, PRESSURES, Kind, Unpacked, unpack

LOG = logging.getLogger("tactiled.client")
WEBSOCKETS_LOG = logging.getLogger("tactiled.client.websockets")
WEBSOCKETS_LOG.setLevel(logging.CRITICAL)  # LOG has why a connection ended
ANSWER_S = 10.0  # that the service may take to answer, or to accept a stream
MIN_CONNECT_S = 0.1  # that an attempt to connect has when `patience_s` is nearly over
CLOSE_S = 0.1  # that closing a connection may take; of a service that hangs, `patience_s` ends so much later
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before the next attempt to connect
MAX_PATIENCE_S = 1e6
MAX_RATE_HZ = 1e4  # that the service takes
FRESH_S = 0.1  # after a longer pause of the loop its image is old; for so long it waits for a newer one
LOG_AFTER_S = 1.0  # after a request without an image: then the log tells the state of its sensor
MAX_QUEUE = 1024  # messages that wait while the loop pauses: of each sensor one status a second, and no images
CONNECTION_ERRORS = OSError, WebSocketException  # TimeoutError is an OSError
TOO_MANY = 4429  # streams of this client: a place may become free
ImageCells = Literal["raster", "taxels"]  # of a restored image: those of its raster, or one value a taxel
REFUSED = set(range(4400, 4500)) - {TOO_MANY}  # close codes that another attempt would get again


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Where the cells of a restored image are."""

    side_mm: float
    origin_mm: tuple[float, float]  # x and y of the first cell's centre, as of the taxels' positions
    mask: Mask  # (rows, columns) that taxels feel; the others have no data


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One frame, raw and restored, and its shear if requested."""

    raw: Floats32  # in `unit`, (rows, columns); one row where the layout is no grid; NaN: unknown
    restored: Floats32  # in `unit`
    flags: Flags  # of raw's shape, as `frames.FLAG_BITS`
    sequence: int
    timestamp: float  # s, Unix, of the frame's first CAN message
    noise_kpa: float  # standard deviation of a raw taxel; NaN in counts
    resolution_mm: float
    status: dict[str, Any]  # the newest of the stream: state, method, ran, loss, warnings, ...
    sensor: str
    shear: Floats32 | None = None  # counts along x and y, (2, rows, columns); NaN: unknown
    noise: float = math.nan  # as noise_kpa, in `unit`
    unit: Unit = PRESSURE  # of pressures: counts where the sensor is uncalibrated
    force: float = math.nan  # total of `restored`, N or counts mm2; NaN where too little is known
    cells: Cells | None = None  # of `restored`; None if the service did not say, or of one value a taxel
    traction: Floats32 | None = None  # kPa, shear restored, (2, ...) of `restored`'s shape; NaN before a tare

    def __str__(self) -> str:
        """Name it and what it tells, without its arrays."""
        return ", ".join((self._name, *(f"{key} {value}" for key, value in self._facts.items())))

    def _repr_html_(self) -> str:
        """Show it in a notebook."""
        images = {"raw": self.raw, "restored": self.restored}
        return html(self._name, images, self.unit, self.noise, self._facts)

    @property
    def _name(self) -> str:
        return f"{self.sensor}, frame {self.sequence}"

    @property
    def _facts(self) -> dict[str, Any]:
        force = {} if math.isnan(self.force) else {"force": f"{self.force:.4g} {FORCE_UNITS[self.unit]}"}
        warnings = "; ".join(each["text"] for each in self.status.get("warnings", ())) or "none"
        return (
            {"state": self.status.get("state"), "method": self.status.get("ran")} | force | {"warnings": warnings}
        )


@dataclass(frozen=True, eq=False)
class Service:
    """How to reach a service."""

    url: str
    headers: dict[str, str]
    ssl_context: ssl.SSLContext | None


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


def _parse_rate(value: object) -> float:
    """An argument in 1/s; ConfigError where it is no rate."""
    if isinstance(value, Real) and 0 <= float(value) <= MAX_RATE_HZ:
        return float(value)
    raise ConfigError(f"rate_hz = {value!r}: give up to {MAX_RATE_HZ:g}, or 0 for every frame")


def parse_cells(value: object) -> ImageCells:
    """What the values of a restored image are; ConfigError where an argument is neither."""
    if value in ("raster", "taxels"):
        return "raster" if value == "raster" else "taxels"
    raise ConfigError(f"image = {value!r}: give 'raster' or 'taxels'")


class Inbox:
    """The messages of one connection: of each sensor the newest image that the loop has not had.

    An image is requested when the loop asks for one, so that it is the newest. Several sensors take turns. After a
    pause of the loop, an image that was requested earlier is old: it is handed out only if no newer one of its
    sensor comes within FRESH_S.
    """

    def __init__(self, kinds: dict[str, Sequence[Kind]]) -> None:
        self._kinds = kinds
        self.status: dict[str, dict[str, Any]] = {}
        self.requested: dict[str, float] = {}  # time (s) at which each sensor's next image was requested
        self._parts: dict[str, dict[Kind, Unpacked]] = {name: {} for name in kinds}
        self._images: dict[str, tuple[Image, float]] = {}  # with the time of the request, in the order of turns
        self._asked_at = self._handed_out = self._fresh_from = time.monotonic()

    def ask(self) -> None:
        """The loop asks for an image."""
        self._asked_at = time.monotonic()
        if self._asked_at - self._handed_out > FRESH_S:
            self._fresh_from = self._asked_at

    def requests(self) -> list[str]:
        """What to send now: requests for sensors that have no open one, and no image requested since `ask`."""
        waiting = {name for name, (_, requested) in self._images.items() if requested >= self._asked_at}
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
        """Take a message; returns the sensor whose image it completes, None if it completes none."""
        if isinstance(data, str):
            status = json.loads(data)
            self.status[status["sensor"]] = status
            return None
        part = unpack(data)
        name, parts = part.sensor, self._parts[part.sensor]
        parts[part.kind] = part
        if {each.sequence for each in parts.values()} != {part.sequence} or len(parts) < len(self._kinds[name]):
            return None
        raw, shear, traction = parts["raw"], parts.get("shear"), parts.get("traction")
        image = Image(
            raw.values, parts["restored"].values, raw.flags.reshape(raw.values.shape), raw.sequence, raw.timestamp,
            math.nan if raw.unit == COUNTS else raw.noise, raw.resolution_mm, self.status[name], name,
            shear.values if shear else None, raw.noise, raw.unit,
            traction=traction.values if traction else None,
        )  # fmt: skip
        self._images[name] = image, self.requested.pop(name, 0.0)
        return name


class Stream:
    """What a stream keeps from one connection to the next: address, last error, how long it still waits."""

    def __init__(
        self,
        service: Service,
        sensor: str | Sequence[str],
        rate_hz: float,
        patience_s: float | None,
        shear: bool | str | Sequence[str],
        image: ImageCells = "raster",
        traction: bool = False,
    ) -> None:
        names = _parse_names("sensor", sensor)
        sheared = [] if shear is False else names if shear is True else _parse_names("shear", shear)
        self._url, self._patience_s = service.url, _parse_patience(patience_s)
        self._title = f"sensor {sensor!r}" if isinstance(sensor, str) else f"sensors {', '.join(names)}"
        more: dict[Kind, list[str]] = {"shear": sheared, "traction": names if traction else []}
        self._kinds: dict[str, Sequence[Kind]] = {
            name: tuple(kind for kind in KINDS if kind in PRESSURES or name in more.get(kind, ()))
            for name in names
        }
        query = {"sensors": ",".join(names), "rate_hz": _parse_rate(rate_hz), "flow": "credit"}
        query |= {kind: ",".join(some) for kind, some in more.items() if some}
        query |= {"image": image} if parse_cells(image) == "taxels" else {}
        self.address = f"ws{service.url.removeprefix('http')}/api/v1/stream?{urlencode(query)}"
        self._options: dict[str, Any] = {"additional_headers": service.headers, "compression": None}
        self._options |= {"max_queue": MAX_QUEUE, "close_timeout": CLOSE_S, "logger": WEBSOCKETS_LOG}
        self._options |= {"ssl": service.ssl_context} if service.ssl_context else {}
        self._back_off_s = BACK_OFF_S[0]
        self._error = ""  # of the newest connection, unless a message came
        self._logged: set[str] = set()  # sensors and errors that the log has told of
        self.connected()
        self.ask()

    def options(self) -> dict[str, Any]:
        """How to connect now."""
        return self._options | {"open_timeout": min(ANSWER_S, max(MIN_CONNECT_S, self._patience_left_s()))}

    def connected(self) -> None:
        """A connection begins."""
        self.inbox = Inbox(self._kinds)

    def ask(self) -> None:
        """The loop asks for an image: the time of `patience_s` starts again."""
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
        """Take a message; TactileError if it is not of this version."""
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
            raise TactileError(f"{self._url}: {describe(error)}") from error
        if isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code in REFUSED:
            raise TactileError(f"{self._url}: {error.rcvd.reason}") from error
        if not isinstance(error, TimeoutError) or not self._error:
            self._error = describe(error)
        patience_s = self._patience_left_s()
        if patience_s == 0:
            raise self._timed_out() from error
        self._log(self._error, f"no connection: {self._error}: trying again")
        wait, self._back_off_s = min(self._back_off_s, patience_s), min(2 * self._back_off_s, BACK_OFF_S[1])
        return wait

    def _patience_left_s(self) -> float:
        return max(0.0, self._since + self._patience_s - time.monotonic())

    def _timed_out(self) -> TactileError:
        why = self._error or ", ".join(self._missing(0.0).values())
        return TactileError(
            f"{self._title} at {self._url}: no image for {self._patience_s} s{f': {why}' if why else ''}"
        )

    def _missing(self, seconds: float) -> dict[str, str]:
        """Sensors that are not live and whose image was requested `seconds` ago or before, each with its state."""
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


class Measuring(NamedTuple):
    """Adds to an image what the service measures in it."""

    known: Callable[[Image], bool]  # whether it can do so without a request
    measured: Callable[[Image], Image]


def read(stream: Stream, measuring: Measuring) -> Generator[Image, None, None]:
    """The images of a stream."""
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
                            yield measuring.measured(image)
                            stream.ask()
        except CONNECTION_ERRORS as error:
            time.sleep(stream.failed(error))


async def aread(stream: Stream, measuring: Measuring) -> AsyncGenerator[Image, None]:
    """The images of a stream, for asyncio."""
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
                            if measuring.known(image):
                                yield measuring.measured(image)
                            else:
                                yield await asyncio.to_thread(measuring.measured, image)
                            stream.ask()
        except CONNECTION_ERRORS as error:
            await asyncio.sleep(stream.failed(error))


def describe(error: Exception) -> str:
    """An error in a line."""
    if isinstance(error, URLError) and isinstance(error.reason, Exception):
        return describe(error.reason)
    if isinstance(error, ConnectionClosed):
        if error.rcvd is not None:
            return f"{error.rcvd.reason or 'closed'} ({error.rcvd.code})"
        return error.sent.reason if error.sent is not None else "the connection broke"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    if isinstance(error, json.JSONDecodeError):
        return f"no service of tactiled: its answer is no JSON: {text}"
    return f"{text}: is the service running?" if isinstance(error, ConnectionRefusedError) else text
