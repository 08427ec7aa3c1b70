"""A fit in a process of its own: frames go on meanwhile, and it ends at once when it is given up."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from threading import Lock
from typing import TypeVar, TypeVarTuple, cast

from threadpoolctl import threadpool_limits

SPAWN = multiprocessing.get_context("spawn")  # a fork would copy the service's threads' locks as they are
NICENESS = 10
Arguments = TypeVarTuple("Arguments")
Outcome = TypeVar("Outcome")


class Cancelled(Exception):  # noqa: N818, no error
    """The fit is no longer wanted."""


class FitProcess:
    """Runs one function; any thread may cancel it."""

    def __init__(self) -> None:
        self._lock, self._cancelled = Lock(), False
        self._process: multiprocessing.process.BaseProcess | None = None

    def run(self, function: Callable[[*Arguments], Outcome], *arguments: *Arguments) -> Outcome:
        """The outcome of a module's function, or what it raises; Cancelled where it is, or has been."""
        receiver, sender = SPAWN.Pipe(duplex=False)
        with receiver:
            with sender, self._lock:
                if self._cancelled:
                    raise Cancelled
                work = SPAWN.Process(target=_work, args=(sender, function, *arguments), daemon=True)
                work.start()
                self._process = work
            try:
                outcome, error = receiver.recv()
            except (EOFError, OSError):
                work.join()
                if self._cancelled:
                    raise Cancelled from None
                raise RuntimeError(f"its process ended with code {work.exitcode}") from None
        work.join()
        if error is not None:
            raise error
        return cast(Outcome, outcome)

    def cancel(self) -> None:
        """End it at once."""
        with self._lock:
            self._cancelled = True
            if self._process is not None:
                self._process.kill()


def start(function: Callable[..., object], *arguments: object) -> Connection:
    """Run a module's function that nobody waits for; its outcome and error (one None) come together."""
    receiver, sender = SPAWN.Pipe(duplex=False)
    with sender:
        SPAWN.Process(target=_work, args=(sender, function, *arguments), daemon=True).start()
    return receiver


def _work(sender: Connection, function: Callable[..., object], *arguments: object) -> None:
    """Run one function in a process of its own."""
    with be_patient():
        send_outcome(sender, function, *arguments)


def send_outcome(sender: Connection, function: Callable[..., object], *arguments: object) -> None:
    """Send what a function gives, or the error that it raises."""
    try:
        sender.send((function(*arguments), None))
    except Exception as error:
        sender.send((None, error))


def be_patient() -> threadpool_limits:
    """Have this process wait for frames, and not frames for it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the service, which ends its daemons
    os.nice(NICENESS)
    return threadpool_limits(1)
