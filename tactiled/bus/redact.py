"""Settings that another package defines, such as python-can's: what nobody declared harmless is a secret."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any
from urllib.parse import quote, unquote, urlsplit

HIDDEN = "hidden"
HARMLESS = frozenset({  # python-can's settings that may be texts and say nothing secret
    "interface", "channel", "app_name", "baudrate", "bitrate", "data_bitrate", "device", "dll", "driver_mode",
    "frame_type", "host", "operation_mode", "override_library_name", "port", "protocol", "serial", "state",
    "tty_baudrate", "ttyBaudrate", "unique_hardware_id",
})  # fmt: skip
SECRET_NAME = re.compile(  # of a number that is a secret; pin, but neither pinky nor mapping
    "token|pass|pwd|secret|key|credential|auth|pincode|pin(?![a-z])", re.IGNORECASE
)
NO_ADDRESS = re.compile(r"(?s)(?!.*://)[^@?#&=]*(@\d+)?")  # no address; @ is a serial port's bit rate
SEPARATORS = re.compile(r"[/@:?#&=]+")  # of an address
SHORT_SECRET = 4  # characters: shorter secrets are replaced in a text only where they stand as a word


class Secret:
    """A setting's value of which only `text` is ever printed."""

    __slots__ = ("_text", "_value")

    def __init__(self, value: Any, text: str = HIDDEN) -> None:
        self._value, self._text = value, text

    def reveal(self) -> Any:
        """The value itself."""
        return self._value

    def __repr__(self) -> str:
        return self._text

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Secret) and self._value == other._value

    __hash__ = None  # type: ignore[assignment]  # a table has no hash either


def seal(settings: Mapping[str, Any], harmless: Collection[str] = ()) -> dict[str, Any]:
    """Settings with every text a Secret that is not of a `harmless` name; numbers and booleans stay."""
    return {name: _seal(str(name), value, harmless) for name, value in settings.items()}


def _seal(name: str, value: Any, harmless: Collection[str]) -> Any:
    if isinstance(value, dict):
        return Secret(value) if SECRET_NAME.search(name) else seal(value, harmless)
    if isinstance(value, list | tuple):
        return [_seal(name, each, harmless) for each in value]
    if isinstance(value, Secret) or value is None:
        return value
    if name in harmless:
        return _address(value) if isinstance(value, str) else value
    if isinstance(value, bool | int | float) and not SECRET_NAME.search(name):
        return value
    return Secret(value)


def _address(text: str) -> str | Secret:
    """A harmless text as it is; of an address only scheme, host, port and path are shown."""
    return text if NO_ADDRESS.fullmatch(text) else Secret(text, redacted(text))


def redacted(address: str) -> str:
    """Scheme, host, port and path; less where a login's end is in doubt."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        return HIDDEN
    if "://" not in address or "@" in parts.path + parts.query + parts.fragment:
        return HIDDEN
    host = f"[{host}]" if ":" in host else host
    return f"{parts.scheme}://{host}{'' if port is None else f':{port}'}{parts.path}"


def reveal(value: Any) -> Any:
    """A setting, or a table or list of them, as the other package wants it."""
    return _opened(value, Secret.reveal)


def show(value: Any) -> Any:
    """A setting, or a table or list of them, as it may be printed."""
    return _opened(value, str)


def _opened(value: Any, replace: Callable[[Secret], Any]) -> Any:
    """A setting, or a table or list of them, with every Secret replaced."""
    if isinstance(value, dict):
        return {key: _opened(each, replace) for key, each in value.items()}
    if isinstance(value, list):
        return [_opened(each, replace) for each in value]
    return replace(value) if isinstance(value, Secret) else value


def redactor(settings: Mapping[str, Any]) -> Callable[[str], str]:
    """What replaces the secrets of `settings` in another package's texts, whole or in parts."""
    secrets = {
        spelling.lower(): instead
        for text, instead in _texts(dict(settings))
        for spelling in _spellings(text)
        if spelling.strip()
    }
    if not secrets:
        return str
    words = (
        re.escape(each) if len(each) >= SHORT_SECRET else rf"(?<!\w){re.escape(each)}(?!\w)"
        for each in sorted(secrets, key=len, reverse=True)
    )
    pattern = re.compile("|".join(words), re.IGNORECASE)
    return lambda text: pattern.sub(lambda match: secrets.get(match[0].lower(), HIDDEN), text)


def _texts(value: Any, inside: bool = False) -> Iterator[tuple[str, str]]:
    """Every secret text in a setting, and what is shown instead; `inside` a secret all are."""
    if isinstance(value, Secret):
        yield from _texts(value.reveal(), inside=True)
        if isinstance(text := value.reveal(), str):
            yield text, str(value)
            public = {HIDDEN, *SEPARATORS.split(str(value))}
            yield from ((part, HIDDEN) for part in SEPARATORS.split(text) if "://" in text and part not in public)
    elif isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _texts(each, inside)
    elif inside:
        yield str(value), HIDDEN


def _spellings(text: str) -> set[str]:
    """A text as it is, in Python's quotes, and in an address."""
    return {text, repr(text)[1:-1], quote(text, safe=""), unquote(text)}
