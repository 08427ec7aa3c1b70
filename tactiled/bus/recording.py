"""Recordings of CAN traffic, in any format that python-can reads, and their way back onto a bus."""

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

from tactiled.bus.logfile import open_log
from tactiled.bus.pace import Pace
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Message

MAX_TIME_S = 1 << 32  # Unix time in 2106: no message is younger, and Foxglove's times go no further
LOG = logging.getLogger(__name__)
SHIPPED = Path(__file__).parents[1] / "recordings"


def names() -> tuple[str, ...]:
    """The recordings that come with the package."""
    return tuple(sorted(_shipped()))


def path(name: str) -> Path:
    """Where a recording of the package is; ConfigError, with those there are, where there is none of that name."""
    try:
        return _shipped()[name]
    except KeyError as error:
        raise ConfigError(f"recording {name!r}: no such recording: choose one of {', '.join(names())}") from error


def _shipped() -> dict[str, Path]:
    return {each.stem: each for each in SHIPPED.glob("*/*.log")}


def read(path: Path) -> Iterator[Message]:
    """Every data frame of a recording, as timed there; ConfigError where the file cannot be read or meant."""
    count = 0
    try:
        with open_log(path) as log:
            for count, each in enumerate(log, 1):
                if not 0 <= each.timestamp < MAX_TIME_S:
                    raise ValueError(f"message {count}: time {each.timestamp:g} s is none from 1970 to 2106")
                if not (each.is_error_frame or each.is_remote_frame):
                    data = bytes(each.data)
                    yield Message(each.timestamp, each.arbitration_id, data, each.is_extended_id, each.is_fd)
    except OSError as error:
        raise ConfigError(f"recording {path}: {error.strerror or error}: give the path of a recording") from error
    except MemoryError as error:
        raise TactileError(f"recording {path}: this machine's memory is full, after {count} messages") from error
    except Exception as error:  # readers raise what they like, AssertionError and struct.error included
        says = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(
            f"recording {path}: {says}: give a recording in a format that python-can reads"
        ) from error


def replay(
    path: Path, send: Callable[[Message], None], stop: Event, loop: bool = False, speed: float = 1.0
) -> int:
    """Send a recording at `speed` times its own pace until its end, or in a loop until `stop`; returns how many.

    A message bears the time of its sending. In a loop a lap follows the one before after the recording's longest
    pause, so that a frame is not cut short. An infinite `speed` sends without a pause. Nothing is sent of a
    recording that cannot be read to its end; steps of its clock are cut, as in `Pace`, and logged.
    """
    if not speed > 0:
        raise ConfigError(f"speed = {speed}: give a number above 0")
    pace, pause = Pace(), 0.0
    for message in read(path):
        last = pace.now
        if step := pace.go(message.time):
            LOG.warning("recording %s %s", path.name, step)
        pause = max(pause, pace.now - last)
    lap, sent, began = pace.now + (pause or 1.0), 0, time.monotonic()
    while not stop.is_set():
        pace = Pace()
        for message in read(path):
            pace.go(message.time)
            if stop.wait(max(0.0, began + pace.now / speed - time.monotonic())):
                return sent
            send(message._replace(time=time.time()))
            sent += 1
        if not loop or not sent:
            break
        began += lap / speed
    return sent
