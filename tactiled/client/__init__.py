"""A client of the service: live images as numpy arrays, reconnecting; and a few requests.

import tactiled

for image in tactiled.connect("http://127.0.0.1:8000").stream("palm"):
    print(image.sequence, image.restored.max(), image.unit)
"""

import asyncio
import atexit
import json
import os
import ssl
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial, wraps
from http.client import HTTPException, HTTPResponse, IncompleteRead
from numbers import Real
from pathlib import Path
from shutil import copyfileobj
from typing import Any, BinaryIO, ParamSpec, TypeVar
from urllib.error import HTTPError
from urllib.parse import parse_qsl, quote, urlencode, urlsplit
from urllib.request import HTTPHandler, HTTPSHandler, Request, build_opener, urlopen
from weakref import WeakSet
from zipfile import BadZipFile

from tactiled.client import results
from tactiled.client.results import Answer, Contact, Contacts, Event, Recording, Region, Window
from tactiled.client.stream import (
    ANSWER_S,
    Cells,
    Image,
    ImageCells,
    Measuring,
    Service,
    Stream,
    aread,
    describe,
    parse_cells,
    read,
)
from tactiled.errors import ConfigError, LoadedError, TactileError
from tactiled.files import whole_file
from tactiled.wire import SHEARED, Kept

__all__ = ["Cells", "Client", "Contact", "Contacts", "Event", "Image", "Recording", "Region", "Window", "connect"]
ROOT = "/api/v1"
MAX_SECONDS, MAX_WAIT_S = 999_999, 30  # of a window; for an event
MAX_ITEMS = 1000  # images, events or recordings in one answer
UPLOAD_S = 600.0  # that the service may take for a part of a recording
NO_RESULT = ValueError, LookupError, TypeError, AttributeError, EOFError, OSError, BadZipFile

Parameters = ParamSpec("Parameters")
Value = TypeVar("Value")
Body = bytes | BinaryIO | None


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
        token_only = (
            [name for name, _ in query] in ([], ["token"]) and not parts.fragment and "@" not in parts.netloc
        )
        text = url.isascii() and url.isprintable() and " " not in url
        if (
            parts.scheme not in ("http", "https")
            or not parts.hostname
            or parts.port == 0
            or not (token_only and text)
        ):
            raise ValueError
    except (ValueError, TypeError, AttributeError):
        address = url.partition("?")[0] if isinstance(url, str) else url  # without a token
        raise ConfigError(
            f"url = {address!r}: give the service's address, such as http://127.0.0.1:8000 (?token=...)"
        ) from None
    return f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}", query[0][1] if query else ""


def _on_thread(method: Callable[Parameters, Value]) -> Callable[Parameters, Coroutine[Any, Any, Value]]:
    """The same method for asyncio: its requests wait on another thread."""

    @wraps(method)
    async def run(*args: Parameters.args, **options: Parameters.kwargs) -> Value:
        return await asyncio.to_thread(method, *args, **options)

    return run


class Client:
    """Talks to one service; every method raises TactileError with the service's message where it refuses.

    `asnapshot` is `snapshot` for asyncio, and so on.
    """

    def __init__(self, url: str, token: str | None = None, ssl_context: ssl.SSLContext | None = None) -> None:
        self.url, token_in_url = _parse_url(url)
        if token and token_in_url:
            raise ConfigError("token: given twice, in url, too")
        token = token or token_in_url
        if not isinstance(token, str) or not token.isascii() or not token.isprintable():
            raise ConfigError("token: give printable ASCII characters")
        if ssl_context is not None and not self.url.startswith("https"):
            raise ConfigError(f"ssl_context: url = {self.url!r} is not https")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._service = Service(self.url, headers, ssl_context)

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
        image: ImageCells = "raster",
        traction: bool = False,
    ) -> Generator[Image, None, None]:
        """The newest images of a sensor, or of several, as they come, for ever; reconnects by itself.

        Each is the newest there is when the loop asks for it: a loop slower than the sensor misses images and gets
        none that is old. At most `rate_hz` a second (0: every frame) of each; with `shear`, of all sensors or of
        those named, whose skin must sense it; with `traction`, that of all as restored. With `image="taxels"` what
        is restored has one value a taxel, the mean of its cells. TactileError if the loop waits for an image for
        `patience_s` (None: for ever), or if the service refuses; after one stream too many, of this client (4429)
        or of all (4503), it waits for a place. The log has once what it waits for.
        """
        form = Stream(self._service, sensor, rate_hz, patience_s, shear, image, traction)
        images = read(form, self._measuring(image))
        _STREAMS.add(images)
        return images

    def astream(
        self,
        sensor: str | Sequence[str],
        rate_hz: float = 0.0,
        patience_s: float | None = None,
        shear: bool | str | Sequence[str] = False,
        image: ImageCells = "raster",
        traction: bool = False,
    ) -> AsyncGenerator[Image, None]:
        """The same as `stream`, for asyncio."""
        form = Stream(self._service, sensor, rate_hz, patience_s, shear, image, traction)
        return aread(form, self._measuring(image))

    def _measuring(self, cells: ImageCells) -> Measuring:
        """Gives an image its cells and total force; the first of a shape waits for the sensor's geometry."""
        geometries: dict[object, Any] = {}

        def known(image: Image) -> bool:
            return (image.sensor, image.restored.shape) in geometries

        def measured(image: Image) -> Image:
            if not known(image):
                try:
                    geometry = self._request("GET", f"/sensors/{_quoted(image.sensor)}/geometry")
                except TactileError:
                    return image
                geometries[image.sensor, image.restored.shape] = geometry
            geometry = geometries[image.sensor, image.restored.shape]
            return self._read(lambda: results.measured(image, geometry, cells))

        return Measuring(known, measured)

    def metrics(self) -> str:
        """Health, counts and times, in Prometheus's text format."""
        return self._answer("GET", "/metrics")[0].decode(errors="replace")

    def snapshot(
        self,
        sensor: str,
        patience_s: float = ANSWER_S,
        shear: bool = False,
        image: ImageCells = "raster",
        traction: bool = False,
    ) -> Image:
        """The newest image, raw and restored, with its total force; `status` has the sensor's state and age.

        Before the first frame it waits for one, for `patience_s`, then TactileError.
        """
        with closing(self.stream(sensor, 0.0, patience_s, shear, image, traction)) as images:
            return next(images)

    def window(self, sensor: str, seconds: float, kind: Kept = "restored", image: ImageCells = "raster") -> Window:
        """The images of the last `seconds` before the newest one, as many as the service still has."""
        _check_seconds("seconds", seconds, MAX_SECONDS)
        if kind not in SHEARED:
            raise ConfigError(f"kind = {kind!r}: give {', '.join(map(repr, SHEARED))}")
        query = {"kind": kind, "last": f"{seconds:.6f}s", "limit": str(MAX_ITEMS), "format": "npz"}
        query |= {"image": image} if parse_cells(image) == "taxels" else {}
        path, pages = f"{ROOT}/sensors/{_quoted(sensor)}/frames", list[Answer]()
        while not pages or query["before"]:
            pages.append(self._answer("GET", f"{path}?{urlencode(query)}"))
            query["before"] = pages[-1][1].get("X-Tactiled-Before", "")
        return self._read(lambda: results.parse_window(sensor, kind, pages))

    def contacts(self, sensor: str) -> Contacts:
        """The contacts in the newest restored image; TactileError before the first frame."""
        return self._get(Contacts, f"/sensors/{_quoted(sensor)}/contacts")

    def regions(self, sensor: str) -> tuple[Region, ...]:
        """The watched regions with their values now, their highest values and integrals."""
        return self._get(tuple[Region, ...], f"/sensors/{_quoted(sensor)}/regions", "regions")

    def events(self, after: int = 0, wait_s: float = 0.0) -> tuple[Event, ...]:
        """Up to 1000 events after the one with the id `after`; if there are none, the next within `wait_s`.

        The service has its last 1000. Ids count up by 1, so that a gap shows how many are lost; they begin at 1
        again when the service is restarted.
        """
        _check_seconds("wait_s", wait_s, MAX_WAIT_S)
        query = urlencode({"after": after, "limit": MAX_ITEMS, "wait": wait_s})
        return self._get(tuple[Event, ...], f"/events?{query}", "events", ANSWER_S + wait_s)

    def recordings(self, after: str = "") -> tuple[Recording, ...]:
        """Up to 1000 recordings of the service's folder, sorted by name, those after the name `after`."""
        query = urlencode({"after": after, "limit": MAX_ITEMS})
        return self._get(tuple[Recording, ...], f"/recordings?{query}", "recordings")

    def download(self, recording: str, path: str | Path) -> None:
        """Copy a recording that does not run to a new file; TactileError if that cannot be written."""
        source = f"{ROOT}/recordings/{_quoted(recording, 'recording')}"
        with self._open("GET", source) as answer, whole_file(Path(path)) as part, part.open("xb") as file:
            copyfileobj(answer, file)
            if answer.length:  # bytes that did not come: reading in pieces says nothing
                raise IncompleteRead(b"", answer.length)

    def upload(self, path: str | Path, name: str | None = None) -> Recording:
        """Add a file to the service's recordings, by its own name or another; OSError if it cannot be read."""
        target = f"/recordings/{_quoted(Path(path).name if name is None else name, 'recording')}"
        with Path(path).open("rb") as file:
            content, _ = self._answer("PUT", ROOT + target, file, UPLOAD_S)
        recording: Recording = self._read(lambda: results.parse(Recording, json.loads(content)))
        return recording

    asensors, aset_method, atare = _on_thread(sensors), _on_thread(set_method), _on_thread(tare)
    asnapshot, awindow, ametrics = _on_thread(snapshot), _on_thread(window), _on_thread(metrics)
    acontacts, aregions, aevents = _on_thread(contacts), _on_thread(regions), _on_thread(events)
    arecordings, adownload, aupload = _on_thread(recordings), _on_thread(download), _on_thread(upload)

    def _get(self, kind: type[Value], path: str, key: str = "", timeout_s: float = ANSWER_S) -> Value:
        answer = self._request("GET", path, timeout_s=timeout_s)
        value: Value = self._read(lambda: results.parse(kind, answer[key] if key else answer))
        return value

    def _read(self, make: Callable[[], Value]) -> Value:
        try:
            return make()
        except NO_RESULT as error:
            raise TactileError(f"{self.url}: no answer of this version of tactiled: {error!r}") from error

    def _request(self, verb: str, path: str, body: object = None, timeout_s: float = ANSWER_S) -> Any:
        data = None if body is None else json.dumps(body).encode()
        content, _ = self._answer(verb, ROOT + path, data, timeout_s)
        try:
            return json.loads(content or b"null")
        except ValueError as error:
            raise TactileError(f"{self.url}: {describe(error)}") from error

    def _answer(self, verb: str, path: str, body: Body = None, timeout_s: float = ANSWER_S) -> Answer:
        with self._open(verb, path, body, timeout_s) as answer:
            return answer.read(), answer.headers

    @contextmanager
    def _open(
        self, verb: str, path: str, body: Body = None, timeout_s: float = ANSWER_S
    ) -> Iterator[HTTPResponse]:
        request = Request(self.url + path, body, self._service.headers, method=verb)
        open_url: Callable[..., HTTPResponse] = partial(urlopen, context=self._service.ssl_context)
        if isinstance(body, bytes):
            request.add_header("Content-Type", "application/json")
        elif body is not None:
            request.add_header("Content-Length", str(os.fstat(body.fileno()).st_size))
            open_url = build_opener(_UploadHandler(context=self._service.ssl_context)).open
        try:
            with open_url(request, timeout=timeout_s) as answer:
                yield answer
        except HTTPError as error:
            with error:
                raise _refusal(self.url, error) from error
        except (OSError, HTTPException, ValueError) as error:
            raise TactileError(f"{self.url}: {describe(error)}") from error


class _UploadHandler(HTTPHandler, HTTPSHandler):
    """Has the answer of a service that refuses a body before it has all of it."""

    def do_open(self, http_class: Any, req: Request, **options: Any) -> HTTPResponse:
        class Connection(http_class):  # type: ignore[misc]
            def request(self, *args: Any, **options: Any) -> None:
                with suppress(BrokenPipeError, ConnectionResetError):
                    super().request(*args, **options)

        return super().do_open(Connection, req, **options)


_STREAMS: WeakSet[Generator[Image, None, None]] = WeakSet()


@atexit.register
def _close_streams() -> None:
    """Close the streams that a program still has, while the threads that this waits for still run."""
    for images in list(_STREAMS):
        with suppress(ValueError):  # a thread is in it
            images.close()


def _quoted(name: object, kind: str = "sensor") -> str:
    """A name in an address."""
    if not isinstance(name, str) or not name:
        raise ConfigError(f"{kind} = {name!r}: give a {kind}'s name")
    return quote(name, safe="")


def _check_seconds(key: str, value: object, limit: float) -> None:
    """ConfigError where an argument is no time from 0 to a limit, s."""
    if not isinstance(value, Real) or not 0 <= float(value) <= limit:
        raise ConfigError(f"{key} = {value!r}: give 0 to {limit} s")


def _refusal(url: str, error: HTTPError) -> TactileError:
    """The service's own message of an error."""
    try:
        problem = json.loads(error.read())
        text = f"{url}: {problem['detail']}"
        return LoadedError(text, problem["seen"]) if problem.get("code") == "loaded" else TactileError(text)
    except (ValueError, KeyError, TypeError, AttributeError, OSError, HTTPException):
        return TactileError(f"{url}: HTTP {error.code}")
