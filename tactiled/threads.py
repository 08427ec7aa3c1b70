"""Threads that a service starts once and ends once."""

from threading import Thread


def join_started(thread: Thread) -> None:
    """Wait for a thread's end; return at once if it was never started, which `Thread.join` refuses."""
    if thread.ident is not None:
        thread.join()
