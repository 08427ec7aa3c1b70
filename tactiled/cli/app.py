"""The command line's entry point: one line and exit code 2 for every error that a user can fix."""

import gc
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event
from typing import Annotated

import typer
from typer.completion import completion_init  # type: ignore[attr-defined]  # not in its __all__

from tactiled.cli.verbs import BenchVerbs, CalibrateVerbs, Verbs
from tactiled.errors import TactileError

EXIT_REFUSED, EXIT_INTERRUPTED = 2, 130
STOP_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP  # the last comes when a terminal is closed
SERVICES = {"run", "demo", "replay", "serve"}

app = typer.Typer(
    name="tactiled",
    cls=Verbs,
    help="Live deconvolution of covered tactile arrays: CAN frames in, surface pressure out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,  # where no verb is given, rich prints nothing
)
bench = typer.Typer(cls=BenchVerbs, help="Measure speed and accuracy on this machine.", no_args_is_help=True)
app.add_typer(bench, name="bench")
calibrate = typer.Typer(cls=CalibrateVerbs, help="Calibrate an array from recordings.", no_args_is_help=True)
app.add_typer(calibrate, name="calibrate")


def _print_version(requested: bool) -> None:
    if requested:
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
    """Run the command line; SIGTERM and a closed terminal end it as Ctrl-C does: temporary files are removed.

    A service that is stopped before it runs ends as one that runs: with exit code 0.
    """
    if SERVICES.intersection(sys.argv[1:2]):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads wait for each other longer than they save
        for each in _stop_signals():
            signal.signal(each, _leave)
    else:
        for each in _stop_signals()[1:]:  # Ctrl-C does it by itself
            signal.signal(each, _interrupt)
    gc.disable()  # imports leave no garbage; `Verbs` enables it again
    completion_init()  # answers shells that ask by the environment
    try:
        app()
    except TactileError as error:
        from tactiled import logs

        logs.announce(str(error), logging.ERROR)
        sys.exit(EXIT_REFUSED)
    except SystemExit as end:
        if end.code == EXIT_INTERRUPTED:
            typer.echo("tactiled: interrupted: unfinished files are removed", err=True)
        raise
    finally:
        _ignore_more()


def _stop_signals() -> list[signal.Signals]:
    """Those that end this process: `nohup` has it ignore SIGHUP."""
    return [each for each in STOP_SIGNALS if each != signal.SIGHUP or signal.getsignal(each) != signal.SIG_IGN]


def _interrupt(*_: object) -> None:
    _ignore_more()
    _insist_on(_interrupt)
    raise KeyboardInterrupt


def _leave(*_: object) -> None:
    _ignore_more()
    _insist_on(_leave)
    sys.exit()


def _insist_on(handler: Callable[..., object]) -> None:
    """Call a handler again if Python drops what it raises: signals may come in callbacks of memory management."""

    def dropped(unraisable: "sys.UnraisableHookArgs") -> None:
        if not issubclass(unraisable.exc_type, SystemExit | KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)
            return
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, 0.01)  # once that callback is over

    sys.unraisablehook = dropped


def _ignore_more() -> None:
    """A second signal would end the cleaning up."""
    for each in _stop_signals():
        signal.signal(each, signal.SIG_IGN)


@contextmanager
def handled(handler: Callable[..., object], *signals: signal.Signals) -> Iterator[None]:
    """Have these signals call `handler` meanwhile."""
    before = {each: signal.signal(each, handler) for each in signals}
    try:
        yield
    finally:
        for each, other in before.items():
            signal.signal(each, other)


@contextmanager
def interrupted() -> Iterator[Event]:
    """An event that what ends a command sets, so that it ends a run between two frames."""
    stop = Event()
    with handled(lambda *_: stop.set(), *_stop_signals()):
        yield stop


@contextmanager
def stoppable() -> Iterator[None]:
    """A block that Ctrl-C, SIGTERM and a closed terminal end alike, which is no failure."""
    with handled(_interrupt, *_stop_signals()), suppress(KeyboardInterrupt):
        yield
