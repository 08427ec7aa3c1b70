"""Threads that a service starts once and ends once, a lock that gives each of them its turn, and their memory."""

import ctypes
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from threading import Condition, Lock, Thread, get_ident
from types import TracebackType

MAX_HOLD_S = 5e-3  # after which the next thread begins beside the one that has the lock

M_ARENA_MAX, MAX_HEAPS = -8, 2  # glibc's mallopt(3)


def limit_heaps() -> None:
    """Have all threads that are not started yet share two heaps; nothing where the C library is not glibc.

    By default glibc has up to eight heaps a core. Threads that come and go use all of them, and each keeps memory
    that is free but lies between blocks in use: `python -m tests.bench soak` shows what that adds up to.
    """
    with suppress(AttributeError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, MAX_HEAPS)


def give_back_heaps() -> None:
    """Return what is free in the heaps to the system, in milliseconds; nothing where this is not glibc."""
    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def join_started(thread: Thread) -> None:
    """Wait for a thread's end; return at once if it was never started, which `Thread.join` refuses."""
    if thread.ident is not None:
        thread.join()


class Worker:
    """A thread for `work`, which waits on `_wake` for something to do, until it is `_stopping`."""

    def __init__(self, name: str, work: Callable[[], None]) -> None:
        self._wake = Condition()
        self._stopping = False
        self._thread = Thread(target=work, name=name, daemon=True)

    def start(self) -> None:
        """Be ready to work."""
        self._thread.start()

    def stop(self) -> None:
        """Work no more; returns when the thread has ended."""
        with self._wake:
            self._stopping = True
            self._wake.notify()
        join_started(self._thread)


# Beside the frames: more threads would take more turns from them.
_BACKGROUND = ThreadPoolExecutor(1, "background")


def run_on_thread(work: Callable[[], None]) -> None:
    """Do `work` on a thread of its own, when what came before is done; the caller goes on at once.

    The interpreter waits for it: a thread that is stopped inside numpy aborts the process. An error is logged.
    """
    _BACKGROUND.submit(work).add_done_callback(Future.result)


class FairLock:
    """A lock that threads get in the order in which they asked; one that keeps it for long loses it to the next.

    numpy releases the interpreter's lock at every array of more than 500 numbers, some hundred times a frame.
    Threads that take it from each other there spend more time on that than on their frames: `tactiled bench load`.
    """

    def __init__(self, max_hold_s: float = MAX_HOLD_S) -> None:
        self._max_hold_s = max_hold_s
        self._lock = Lock()
        self._waiting: deque[tuple[int, Lock]] = deque()  # thread, and what is released when it gets the lock
        self._thread: int | None = None  # that has it
        self._passed_on = 0  # times

    def __enter__(self) -> None:
        thread = get_ident()
        with self._lock:
            if self._thread is None:
                self._thread = thread
                return
            turn, seen = Lock(), self._passed_on
            turn.acquire()
            self._waiting.append((thread, turn))
        while not turn.acquire(timeout=self._max_hold_s):
            with self._lock:
                if seen == self._passed_on:
                    self._pass_on()
                seen = self._passed_on

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            if self._thread == get_ident():  # else it has lost it
                self._pass_on()

    def _pass_on(self) -> None:
        """Give the lock to the thread that has waited longest."""
        self._passed_on += 1
        self._thread = None
        if self._waiting:
            self._thread, turn = self._waiting.popleft()
            turn.release()


FRAME_LOCK = FairLock()  # of all threads that assemble or restore frames, or send them
