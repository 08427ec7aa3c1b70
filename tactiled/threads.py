"""Threads that a service starts once and ends once, and their turns at the interpreter."""

from collections import deque
from threading import Lock, Thread, get_ident
from types import TracebackType

LONGEST_TURN_S = 5e-3  # after which the next thread begins beside the one that has the turn


def join_started(thread: Thread) -> None:
    """Wait for a thread's end; return at once if it was never started, which `Thread.join` refuses."""
    if thread.ident is not None:
        thread.join()


class Turns:
    """Lets one thread work at a time, in the order in which they asked; a slow one delays no other for long.

    numpy releases the interpreter's lock at every array of more than 500 numbers, some hundred times a frame.
    Threads that take it from each other there spend more time on that than on their frames: `tactiled bench load`.
    """

    def __init__(self, longest_s: float = LONGEST_TURN_S) -> None:
        self._longest_s = longest_s
        self._lock = Lock()
        self._waiting: deque[tuple[int, Lock]] = deque()  # thread, and what is released when its turn comes
        self._thread: int | None = None  # that has the turn
        self._count = 0  # of turns so far

    def __enter__(self) -> None:
        thread = get_ident()
        with self._lock:
            if self._thread is None:
                self._thread = thread
                return
            turn, count = Lock(), self._count
            turn.acquire()
            self._waiting.append((thread, turn))
        while not turn.acquire(timeout=self._longest_s):
            with self._lock:
                if count == self._count:
                    self._pass_on()
                count = self._count

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            if self._thread == get_ident():  # else another one has begun meanwhile
                self._pass_on()

    def _pass_on(self) -> None:
        """Give the turn to the thread that has waited longest."""
        self._count += 1
        self._thread = None
        if self._waiting:
            self._thread, turn = self._waiting.popleft()
            turn.release()


FRAME_TURNS = Turns()  # of all threads that assemble or restore frames
