"""A generator in a process with bounds: reading a foreign file may take unbounded time or memory.

A process waits for the next generator while none runs, so that only the first one waits for its start.
"""

import atexit
import logging
import marshal
import math
import os
import pickle
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, NamedTuple

COMMAND = "import sys; from tactiled.bus.bounded_process import work; work(int(sys.argv[1]))"
MAX_BATCH, MAX_BATCH_S = 1024, 0.1  # items sent at once
IDLE_S = 60.0  # without work until a process ends
NEXT, CLOSE, READY = b"", b"close", b"ready"  # commands to a process, apart from generators to run
READY_S = 1.0  # that an idle one may take to answer


class Bounds(NamedTuple):
    """What a generator may take of this machine."""

    cpu_s: float  # processor time without an item
    memory_mb: float  # beside what the process has at its start


class Exceeded(Exception):  # noqa: N818, no fault of ours
    """The process was ended: its generator passed a bound, or died."""


class BoundedProcess:
    """Runs a module's generator of marshal's types, with bounds; any thread may end it."""

    def __init__(self, bounds: Bounds, function: Callable[..., Iterable[Any]], *arguments: object) -> None:
        self._bounds, self._job = bounds, pickle.dumps((bounds, function, arguments))
        self._lock, self._cancelled = Lock(), False
        self._worker: _Worker | None = None

    def cancel(self) -> None:
        """End it at once."""
        with self._lock:
            self._cancelled = True
            if self._worker is not None:
                self._worker.kill()

    def __iter__(self) -> Iterator[Any]:
        """Its items, or what it raises; Exceeded where it was ended."""
        worker, reusable = self._begun(), False
        try:
            batch, error = self._answer(worker)
            reusable = True  # False once more batches are requested than read
            yield from batch or ()
            ahead = 2
            while batch is not None:
                reusable = False
                worker.ask(ahead)
                batch, error = self._answer(worker)
                reusable, ahead = batch is None, 1
                yield from batch or ()
            if error is not None:
                raise error
        finally:
            with self._lock:
                self._worker = None
            worker.release(reusable and not self._cancelled)

    def _begun(self) -> "_Worker":
        """A process that was asked for the first item: the idle one, unless it has ended."""
        with self._lock:
            if self._cancelled:
                raise Exceeded("it was cancelled")
            self._worker = _Worker.idle_one() or _Worker()
            self._worker.begin(self._job)
            return self._worker

    def _answer(self, worker: "_Worker") -> tuple[list[Any] | None, Exception | None]:
        """The next items; None at the end, with an error where there is one."""
        try:
            return worker.answer()
        except (EOFError, OSError):
            code = worker.close()
        if self._cancelled:
            raise Exceeded("it was cancelled")
        if code == -signal.SIGXCPU:
            raise Exceeded(f"nothing comes of it in {self._bounds.cpu_s:.0f} s of processor time")
        raise Exceeded(f"the process that reads it ended with code {code}")


class _Worker:
    """A process as its parent sees it."""

    idle: list["_Worker"] = []  # noqa: RUF012, one of this process at most

    def __init__(self) -> None:
        self._pipe, other = Pipe()
        path = {"PYTHONPATH": os.pathsep.join(sys.path)}
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-c", COMMAND, str(other.fileno())],
                stdin=subprocess.DEVNULL, env=os.environ | path, pass_fds=[other.fileno()],
            )  # fmt: skip

    @classmethod
    def idle_one(cls) -> "_Worker | None":
        """The idle one, if it has not ended."""
        try:
            worker = cls.idle.pop()
        except IndexError:
            return None
        with suppress(EOFError, OSError):
            worker._pipe.send_bytes(READY)
            if worker._pipe.poll(READY_S) and worker._pipe.recv_bytes() == READY:
                return worker
        worker.close()
        return None

    def begin(self, job: bytes) -> None:
        """Run a generator, and ask for its first item."""
        with suppress(OSError):
            self._pipe.send_bytes(job)
        self.ask(1)

    def ask(self, count: int) -> None:
        """Ask for batches; if the process has ended, `answer` reports it."""
        with suppress(OSError):
            for _ in range(count):
                self._pipe.send_bytes(NEXT)

    def answer(self) -> tuple[list[Any] | None, Exception | None]:
        """A batch, or None and how it ended; EOFError or OSError where the process has ended."""
        data = self._pipe.recv_bytes()
        if data[:1] == b"i":
            return marshal.loads(memoryview(data)[1:]), None
        error, cause = pickle.loads(data[1:])
        if error is not None:
            error.__cause__ = cause
        return None, error

    def release(self, reusable: bool) -> None:
        """Keep it for the next generator if it is idle and the only one; else end it."""
        if reusable and not self.idle:
            with suppress(OSError):
                self._pipe.send_bytes(CLOSE)
                self.idle.append(self)
                return
        self.close()

    def kill(self) -> None:
        """End it, also while a thread waits for its answer."""
        self._process.kill()

    def close(self) -> int:
        """End it; gives its code."""
        self.kill()
        code = self._process.wait()
        self._pipe.close()
        return code


@atexit.register
def _end_idle() -> None:
    while _Worker.idle:
        _Worker.idle.pop().close()


def work(descriptor: int) -> None:
    """Run generators one after the other in this process, until it is idle or its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    logging.disable()  # a line for each of a million objects
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pipe, commands = Connection(descriptor), SimpleQueue[bytes]()
    Thread(target=_listen, args=(pipe, commands), daemon=True).start()
    while True:
        _limit(resource.RLIMIT_CPU, math.inf)
        try:
            job = commands.get(timeout=IDLE_S)
        except Empty:
            return
        if job == READY:
            pipe.send_bytes(READY)
        elif job not in (NEXT, CLOSE):
            _run(pipe, commands, *pickle.loads(job))


def _listen(pipe: Connection, commands: "SimpleQueue[bytes]") -> None:
    """Take commands, and end this process when its parent ends."""
    with suppress(EOFError, OSError):
        while True:
            commands.put(pipe.recv_bytes())
    os._exit(0)


def _run(
    pipe: Connection,
    commands: "SimpleQueue[bytes]",
    bounds: Bounds,
    function: Callable[..., Iterable[Any]],
    arguments: tuple[Any, ...],
) -> None:
    """Run one generator as far as it is asked for."""
    _limit(resource.RLIMIT_DATA, 1024 * _data_kib() + bounds.memory_mb * 1e6)
    batches, error = _batched(iter(function(*arguments))), None
    while commands.get() != CLOSE:
        _limit(resource.RLIMIT_CPU, time.process_time() + bounds.cpu_s)
        try:
            batch = next(batches)
        except StopIteration:
            break
        except Exception as reason:
            error = reason
            break
        pipe.send_bytes(b"i" + marshal.dumps(batch))
    else:
        return
    pipe.send_bytes(b"e" + pickle.dumps((_portable(error), _portable(error and error.__cause__))))


def _batched(items: Iterator[Any]) -> Iterator[list[Any]]:
    """Lists of items: one item first, then more while they come fast; items before an error come before it."""
    size, goes_on = 1, True
    while goes_on:
        batch, began = list[Any](), time.monotonic()
        try:
            batch.extend(islice(items, size))
        except Exception:
            yield batch
            raise
        goes_on = len(batch) == size
        yield batch
        fast = time.monotonic() - began < MAX_BATCH_S
        size = min(2 * size, MAX_BATCH) if fast else max(size // 2, 1)


def _portable(error: BaseException | None) -> BaseException | None:
    """An error as it can be sent: of a library that forbids it, its text alone."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ValueError(f"{error}" or type(error).__name__)
    return error


def _limit(what: int, value: float) -> None:
    """Set a limit of this process, as far as the system lets it."""
    _, hard = resource.getrlimit(what)
    soft = resource.RLIM_INFINITY if value == math.inf else math.ceil(value)
    if hard != resource.RLIM_INFINITY:
        soft = hard if soft == resource.RLIM_INFINITY else min(soft, hard)
    resource.setrlimit(what, (soft, hard))


def _data_kib() -> int:
    """Memory that this process may write to."""
    try:
        return int(Path("/proc/self/status").read_text().partition("VmData:")[2].split()[0])
    except OSError:  # no Linux
        return 0
