"""Recordings of CAN traffic, in any format that python-can reads, and their way back onto a bus."""

import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from threading import Event

import can

from tactiled.errors import ConfigError
from tactiled.frames import Message

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
    try:
        with can.LogReader(path) as log:
            yield from (
                Message(each.timestamp, each.arbitration_id, bytes(each.data), each.is_extended_id, each.is_fd)
                for each in log
                if not (each.is_error_frame or each.is_remote_frame)
            )
    except OSError as error:
        raise ConfigError(f"recording {path}: {error.strerror or error}: give the path of a recording") from error
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
    pause, so that a frame is not cut short. An infinite `speed` sends without a pause.
    """
    if not speed > 0:
        raise ConfigError(f"speed = {speed}: give a number above 0")
    messages = tuple(read(path))
    times = [each.time for each in messages]
    pause = max((later - each for each, later in pairwise(times)), default=1.0)
    began, sent = time.monotonic(), 0
    while messages and not stop.is_set():
        for message in messages:
            due = began + (message.time - times[0]) / speed
            if stop.wait(max(0.0, due - time.monotonic())):
                return sent
            send(message._replace(time=time.time()))
            sent += 1
        if not loop:
            break
        began += (times[-1] - times[0] + pause) / speed
    return sent
