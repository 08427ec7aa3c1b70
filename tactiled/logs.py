"""What the service logs: one line an event, for people or as JSON, without secrets, bounded in rate."""

import json
import logging
import re
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from tactiled.bus.redact import HIDDEN, redactor

Style = Literal["console", "json"]
MAX_A_MINUTE = 10  # of each kind
MINUTE_S = 60.0
NUMBER = re.compile(r"\d+")
SECRET = re.compile(r"(?<=token=)[^\s&#]+|(?<=bearer )\S+|(?<=://)[^\s/@]+(?=@)", re.IGNORECASE)
MAX_CONFIGURATIONS = 8  # whose secrets are hidden: those of before reloads
LOG = logging.getLogger("tactiled")
HANDLER = logging.StreamHandler()
_redactors: deque[Callable[[str], str]] = deque(maxlen=MAX_CONFIGURATIONS)


class LogLimit(logging.Filter):
    """Passes the first messages of each kind in a minute; the next minute's first one tells how many were not."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._minutes: dict[str, tuple[float, int]] = {}  # when it began, messages in it, by kind

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log a message; kinds differ by their fields, and their text but for numbers and values."""
        kind, now = f"{NUMBER.sub('#', str(record.msg))} {_fields(record)}", self._clock()
        began, count = self._minutes.get(kind, (now, 0))
        suppressed = 0
        if now - began >= MINUTE_S:
            suppressed, began, count = max(0, count - MAX_A_MINUTE), now, 0
        self._minutes[kind] = began, count + 1
        if suppressed:
            record.msg = f"{record.msg} ({suppressed} like it were left out before)"
        return count < MAX_A_MINUTE


class _Formatter(logging.Formatter):
    """A record as one line; a traceback follows it, or is in its JSON."""

    def __init__(self, style: Style) -> None:
        super().__init__()
        self.style = style

    def format(self, record: logging.LogRecord) -> str:
        """The line, without a secret and without what would control a terminal or forge a line."""
        moment = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        fields, text = _fields(record), redact(record.getMessage())
        trace = redact(self.formatException(record.exc_info)) if record.exc_info else ""
        if self.style == "json":
            line = {
                "time": moment,
                "level": record.levelname.lower(),
                "logger": record.name,
                **fields,
                "text": text,
            }
            return json.dumps(line | ({"exception": trace} if trace else {}))
        words = moment, record.levelname, *map(str, fields.values())
        return "\n".join(map(printable, (f"{' '.join(words)}: {text}", *trace.splitlines())))


def _fields(record: logging.LogRecord) -> dict[str, Any]:
    """What a record names beside its text: the event, the sensor, the bus, ..."""
    fields: dict[str, Any] = getattr(record, "fields", {})
    return {name: value for name, value in fields.items() if value is not None}


def printable(text: str) -> str:
    """A text without what would begin a new line or control a terminal."""
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


def redact(text: str) -> str:
    """A text without tokens, logins of addresses, and the secrets of the configuration."""
    for hide in _redactors:
        text = hide(text)
    return SECRET.sub(HIDDEN, text)


def hide(settings: Mapping[str, Any]) -> None:
    """Leave the secrets of these settings, and of those before, out of every line from now on."""
    _redactors.append(redactor(settings))


def configure(style: Style) -> Style:
    """Log to stderr from now on."""
    HANDLER.stream = sys.stderr
    HANDLER.setFormatter(_Formatter(style))
    if not HANDLER.filters:
        HANDLER.addFilter(LogLimit())
    logging.getLogger().addHandler(HANDLER)
    logging.getLogger("tactiled").setLevel(logging.INFO)
    if style == "json":  # else Python prints them
        sys.excepthook = lambda *error: LOG.critical("the process failed", exc_info=error)
        threading.excepthook = lambda args: LOG.critical("a thread failed", exc_info=args.exc_value)
    return style


def announce(text: str, level: int = logging.INFO, *, aside: bool = False) -> None:
    """A line for whoever started the process; a warning, an error or an aside on stderr; as JSON logged."""
    if getattr(HANDLER.formatter, "style", None) == "json":
        LOG.log(level, "%s", text)
    else:
        print(f"tactiled: {text}", file=sys.stderr if aside or level > logging.INFO else sys.stdout, flush=True)


def progress(text: str) -> None:
    """A line on what takes time now, on stderr: whoever reads stdout waits for the address."""
    announce(text, aside=True)
