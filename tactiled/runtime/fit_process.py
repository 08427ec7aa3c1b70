"""A fit in a process of its own: frames go on meanwhile, and it ends at once when it is given up."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from threading import Lock
from typing import TypeVar, TypeVarTuple, cast

from threadpoolctl import threadpool_limits

SPAWN = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
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
        """The result of a module's function, or its exception; Cancelled after `cancel`."""
        receiver, sender = SPAWN.Pipe(duplex=False)
        with receiver:
            with sender, self._lock:
                if self._cancelled:
                    raise Cancelled
                work = patient_process(send_outcome, sender, function, *arguments)
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
        patient_process(send_outcome, sender, function, *arguments).start()
    return receiver


def send_outcome(sender: Connection, function: Callable[..., object], *arguments: object) -> None:
    """Send what a function gives, or the error that it raises."""
    try:
        sender.send((function(*arguments), None))
    except Exception as error:
        sender.send((None, error))


def patient_process(work: Callable[..., None], *arguments: object) -> multiprocessing.process.BaseProcess:
    """A process, yet to be started, that waits for frames, and not frames for it."""
    return SPAWN.Process(target=_work_patiently, args=(NICENESS, work, *arguments), daemon=True)


def _work_patiently(niceness: int, work: Callable[..., None], *arguments: object) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the service, which ends its daemons
    os.nice(niceness)
    with threadpool_limits(1):
        work(*arguments)
