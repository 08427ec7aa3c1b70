"""Frames on their way from the thread of a bus to the thread that restores them; only the newest one waits."""

import time
from collections.abc import Callable
from dataclasses import replace
from math import inf

from tactiled.frames import Loss, RawFrame
from tactiled.threads import Worker

QUICK_S = 5e-3  # of processor time for the last frame, up to which the bus's thread restores the next one


class HandOver(Worker):
    """Restores the newest frame on a thread of its own; on the caller's if frames take little time."""

    def __init__(self, name: str, restore: Callable[[RawFrame, float], None]) -> None:
        """`restore` gets a frame and when it was assembled (s)."""
        super().__init__(f"restore {name}", self._work)
        self._restore = restore
        self._waiting: tuple[RawFrame, float] | None = None  # the newest frame, and when it was assembled (s)
        self._working = False
        self._finished = 0  # frames
        self._took_s = inf  # of processor time for the last frame; inf before the first, which builds its tables
        self.skipped = 0  # frames
        self.loss = Loss()  # of the newest frame

    @property
    def turns(self) -> int | None:
        """Frames that are finished; None while there is none to restore."""
        return self._finished if self._working or self._waiting is not None else None

    def offer(self, frame: RawFrame, assembled: float, wake: bool) -> None:
        """Let a frame wait, in place of one that still waits, which is skipped.

        If frames take little time, its thread is woken only with `wake`: else the caller is to call `take_turn`.
        """
        with self._wake:
            self.skipped += self._waiting is not None
            if self.skipped:
                frame = replace(frame, loss=replace(frame.loss, skipped=self.skipped))
            self._waiting, self.loss = (frame, assembled), frame.loss
            if wake or self._took_s > QUICK_S:
                self._wake.notify()

    def take_turn(self) -> None:
        """Restore the waiting frame on this thread, which saves waking the other, unless frames take long."""
        if self._took_s <= QUICK_S:
            self._restore_waiting()

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._stopping or (self._waiting is not None and not self._working))
                if self._stopping:
                    return
            self._restore_waiting()

    def _begin_turn(self) -> tuple[RawFrame, float] | None:
        """The frame that waits; None if there is none, or a thread still restores the one before."""
        with self._wake:
            if self._working or (waiting := self._waiting) is None:
                return None
            self._waiting, self._working = None, True
            return waiting

    def _restore_waiting(self) -> None:
        """Restore the frame that waits, unless a thread still restores the one before."""
        if (waiting := self._begin_turn()) is None:
            return
        began = time.thread_time()
        self._restore(*waiting)
        self._took_s = time.thread_time() - began
        self._finished += 1
        with self._wake:
            self._working = False
            if self._waiting is not None:
                self._wake.notify()
