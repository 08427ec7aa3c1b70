"""The command line's one door: a clear line and exit code 2 for every error that is the user's to mend."""

import gc
import signal
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from threading import Event
from typing import Annotated

import typer
from typer.completion import completion_init  # type: ignore[attr-defined]  # not in its __all__

from tactiled.cli.verbs import BenchVerbs, Verbs
from tactiled.errors import ConfigError, TactileError

INTERRUPTED = 130  # exit code
STOPS = signal.SIGINT, signal.SIGTERM

app = typer.Typer(
    name="tactiled",
    cls=Verbs,
    help="Live deconvolution of covered tactile arrays: CAN frames in, surface pressure out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
bench = typer.Typer(cls=BenchVerbs, help="Measure speed and accuracy on this machine.", no_args_is_help=True)
app.add_typer(bench, name="bench")


def _print_version(asked: bool) -> None:
    """Print the version and exit, if it is asked for."""
    if asked:
        from tactiled import __version__  # looked up in the package's metadata

        typer.echo(f"tactiled {__version__}")
        raise typer.Exit


@app.callback()
def tactiled(
    _: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Take the options that stand before a verb."""


def main() -> None:
    """Run the command line; SIGTERM ends it as Ctrl-C does, so that no temporary file stays."""
    signal.signal(signal.SIGTERM, _interrupt)
    gc.disable()  # imports leave no garbage; behind the verb's own it is looked for again
    completion_init()  # tells shells what to complete, when they ask by the environment
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
    from rich.console import Console  # which only errors need here

    Console(stderr=True, soft_wrap=True, highlight=False).print("tactiled:", line, markup=False)


def _interrupt(*_: object) -> None:
    for each in STOPS:  # a second one would end the clearing up
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt


@contextmanager
def _handled(handler: Callable[..., object]) -> Iterator[None]:
    """Have Ctrl-C and SIGTERM call `handler` meanwhile."""
    before = {each: signal.signal(each, handler) for each in STOPS}
    try:
        yield
    finally:
        for each, other in before.items():
            signal.signal(each, other)


@contextmanager
def interrupted() -> Iterator[Event]:
    """An event that Ctrl-C and SIGTERM set, so that they end a run between two frames."""
    stop = Event()
    with _handled(lambda *_: stop.set()):
        yield stop


@contextmanager
def stoppable() -> Iterator[None]:
    """A block that Ctrl-C and SIGTERM end alike, which is no failure."""
    with _handled(_interrupt), suppress(KeyboardInterrupt):
        yield


def choose(option: str, name: str | None, known: Collection[str]) -> str:
    """The one of `known` that --`option` names, or the only one there is; ConfigError otherwise."""
    if name is None and len(known) > 1:
        raise ConfigError(f"--{option} is missing: choose one of {', '.join(known)}")
    if name is not None and name not in known:
        raise ConfigError(f"--{option} {name}: no such {option}: choose one of {', '.join(known)}")
    return name or next(iter(known))
