"""The command line's one door: a clear line and exit code 2 for every error that is the user's to mend."""

import signal
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from threading import Event

import typer
from rich.console import Console

from tactiled.errors import ConfigError, TactileError

INTERRUPTED = 130  # exit code

app = typer.Typer(
    name="tactiled",
    help="Live deconvolution of covered tactile arrays: CAN frames in, surface pressure out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
bench = typer.Typer(help="Measure speed and accuracy on this machine.", no_args_is_help=True)
app.add_typer(bench, name="bench")


def main() -> None:
    """Run the command line; SIGTERM ends it as Ctrl-C does, so that no temporary file stays."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        app()
    except TactileError as error:
        _say(str(error))
        sys.exit(2)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            _say("interrupted: unfinished files are removed")
        raise


def _say(line: str) -> None:
    Console(stderr=True, soft_wrap=True, highlight=False).print("tactiled:", line, markup=False)


def _interrupt(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one would end the clearing up
    raise KeyboardInterrupt


@contextmanager
def interrupted() -> Iterator[Event]:
    """An event that Ctrl-C and SIGTERM set, so that they end a run between two frames."""
    stop = Event()
    before = {each: signal.signal(each, lambda *_: stop.set()) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def choose(option: str, name: str | None, known: Collection[str]) -> str:
    """The one of `known` that --`option` names, or the only one there is; ConfigError otherwise."""
    if name is None and len(known) > 1:
        raise ConfigError(f"--{option} is missing: choose one of {', '.join(known)}")
    if name is not None and name not in known:
        raise ConfigError(f"--{option} {name}: no such {option}: choose one of {', '.join(known)}")
    return name or next(iter(known))
