"""A client of the service: live images as numpy arrays, reconnecting; and a few requests.

import tactiled

for image in tactiled.connect("http://127.0.0.1:8000").stream("palm"):
    print(image.sequence, image.restored.max(), image.unit)
"""

import atexit
import json
import ssl
from collections.abc import AsyncGenerator, Generator, Sequence
from contextlib import suppress
from http.client import HTTPException
from typing import Any
from urllib.error import HTTPError
from urllib.parse import parse_qsl, quote, urlsplit
from urllib.request import Request, urlopen
from weakref import WeakSet

from tactiled.client.stream import ANSWER_S, Image, Service, Stream, aread, describe, read
from tactiled.errors import ConfigError, LoadedError, TactileError

__all__ = ["Client", "Image", "connect"]


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
    ) -> Generator[Image, None, None]:
        """The newest images of a sensor, or of several, as they come, for ever; reconnects by itself.

        Each is the newest there is when the loop asks for it: a loop slower than the sensor misses images and gets
        none that is old. At most `rate_hz` a second (0: every frame) of each; with `shear`, of all sensors or of
        those named, whose skin must sense it. TactileError if the loop waits for an image for `patience_s` (None:
        for ever), or if the service refuses; after one stream too many, of this client (4429) or of all (4503), it
        waits for a place. The log has once what it waits for.
        """
        images = read(Stream(self._service, sensor, rate_hz, patience_s, shear))
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
        return aread(Stream(self._service, sensor, rate_hz, patience_s, shear))

    def metrics(self) -> str:
        """Health, counts and times, in Prometheus's text format."""
        return self._answer(Request(f"{self.url}/metrics", headers=self._service.headers)).decode(errors="replace")

    def _request(self, verb: str, path: str, body: object = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        headers = self._service.headers | ({"Content-Type": "application/json"} if data else {})
        answer = self._answer(Request(f"{self.url}/api/v1{path}", data, headers, method=verb))
        try:
            return json.loads(answer or b"null")
        except ValueError as error:
            raise TactileError(f"{self.url}: {describe(error)}") from error

    def _answer(self, request: Request) -> bytes:
        try:
            with urlopen(request, timeout=ANSWER_S, context=self._service.ssl_context) as answer:  # http or https
                body: bytes = answer.read()
                return body
        except HTTPError as error:
            raise _refusal(self.url, error) from error
        except (OSError, HTTPException, ValueError) as error:
            raise TactileError(f"{self.url}: {describe(error)}") from error


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


def _refusal(url: str, error: HTTPError) -> TactileError:
    """The service's own message of an error."""
    try:
        problem = json.loads(error.read())
        text = f"{url}: {problem['detail']}"
        return LoadedError(text, problem["seen"]) if problem.get("code") == "loaded" else TactileError(text)
    except (ValueError, KeyError, TypeError, AttributeError, OSError, HTTPException):
        return TactileError(f"{url}: HTTP {error.code}")
