"""Processes that frames do not wait for: one for a fit, which can be given up, and one for short work."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Lock
from typing import TypeVar, TypeVarTuple, cast

from threadpoolctl import threadpool_limits

SPAWN = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
NICENESS = 10
IDLE_S = 60.0  # without work until the one for short work ends
Arguments = TypeVarTuple("Arguments")
Outcome = TypeVar("Outcome")


class Cancelled(Exception):  # noqa: N818, no error
    """The fit is no longer wanted."""


class FitProcess:
    """Runs one function; any thread may cancel it."""

    def __init__(self) -> None:
        self._lock, self._cancelled = Lock(), False
        self._process: BaseProcess | None = None

    def run(self, function: Callable[[*Arguments], Outcome], *arguments: *Arguments) -> Outcome:
        """The result of a module's function, or its exception; Cancelled after `cancel`."""
        receiver, sender = SPAWN.Pipe(duplex=False)
        with receiver:
            with sender, self._lock:
                if self._cancelled:
                    raise Cancelled
                work = _process(NICENESS, send_outcome, sender, function, *arguments)
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


class SideProcess:
    """Runs functions, one after the other; it begins with the first, and ends when idle or without a reference.

    Its work is short, and a request waits for it: at a lower priority than the service's, the request would take a
    minute on a busy machine.
    """

    def __init__(self, idle_s: float = IDLE_S) -> None:
        self._idle_s, self._lock = idle_s, Lock()
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None

    def run(self, function: Callable[[*Arguments], Outcome], *arguments: *Arguments) -> Outcome:
        """What a module's function gives, or raises; RuntimeError where its process ended twice."""
        with self._lock:
            try:
                outcome, error = self._exchange(function, *arguments)
            except (EOFError, OSError):  # it has ended since: nobody needed it
                self._end()
                try:
                    outcome, error = self._exchange(function, *arguments)
                except (EOFError, OSError) as reason:
                    code = self._end()
                    raise RuntimeError(f"the process for {function.__name__} ended with code {code}") from reason
        if error is not None:
            raise error
        return cast(Outcome, outcome)

    def _exchange(self, *work: object) -> tuple[object, Exception | None]:
        if self._pipe is None:
            self._pipe, other = SPAWN.Pipe()
            with other:
                self._process = _process(0, _work, other, self._idle_s)
                self._process.start()
        self._pipe.send(work)
        answer: tuple[object, Exception | None] = self._pipe.recv()
        return answer

    def _end(self) -> int | None:
        """The code with which it ended."""
        if self._pipe is None or self._process is None:
            return None
        self._pipe.close()
        self._process.kill()
        self._process.join()
        self._pipe = None
        return self._process.exitcode


def start(function: Callable[..., object], *arguments: object) -> Connection:
    """Run a module's function that nobody waits for; its outcome and error (one None) come together."""
    receiver, sender = SPAWN.Pipe(duplex=False)
    with sender:
        _process(NICENESS, send_outcome, sender, function, *arguments).start()
    return receiver


def send_outcome(sender: Connection, function: Callable[..., object], *arguments: object) -> None:
    """Send what a function gives, or the error that it raises."""
    try:
        sender.send((function(*arguments), None))
    except Exception as error:
        sender.send((None, error))


def _process(niceness: int, work: Callable[..., None], *arguments: object) -> BaseProcess:
    """A process, yet to be started."""
    return SPAWN.Process(target=_begin, args=(niceness, work, *arguments), daemon=True)


def _begin(niceness: int, work: Callable[..., None], *arguments: object) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the service, which ends its daemons
    os.nice(niceness)
    with threadpool_limits(1):
        work(*arguments)


def _work(pipe: Connection, idle_s: float) -> None:
    """Do what comes until nothing has come for so long, or the service has ended."""
    with suppress(EOFError, OSError):
        while pipe.poll(idle_s):
            send_outcome(pipe, *pipe.recv())
