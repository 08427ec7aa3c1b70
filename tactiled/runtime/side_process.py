"""Work that must not delay frames, in one extra process, which ends when it is idle."""

from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Lock
from typing import TypeVar, TypeVarTuple, cast

from tactiled.runtime.fit_process import SPAWN, patient_process, send_outcome

IDLE_S = 60.0  # without work until it ends
Arguments = TypeVarTuple("Arguments")
Outcome = TypeVar("Outcome")


class SideProcess:
    """Runs functions, one after the other; it begins with the first, and ends when idle or without a reference."""

    def __init__(self, idle_s: float = IDLE_S) -> None:
        self._idle_s, self._lock = idle_s, Lock()
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None

    def run(self, function: Callable[[*Arguments], Outcome], *arguments: *Arguments) -> Outcome:
        """What a module's function gives, or raises; RuntimeError where its process ended twice."""
        with self._lock:
            try:
                outcome, error = self._exchange(function, *arguments)
            except (EOFError, OSError):  # it had ended: nobody had needed it
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
                self._process = patient_process(_work, other, self._idle_s)
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


def _work(pipe: Connection, idle_s: float) -> None:
    """Do what comes until nothing has come for so long, or the service has ended."""
    with suppress(EOFError, OSError):
        while pipe.poll(idle_s):
            send_outcome(pipe, *pipe.recv())
