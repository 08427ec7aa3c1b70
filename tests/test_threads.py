import subprocess
import sys
import threading

import pytest

from tactiled.threads import FairLock, run_on_thread
from tests.conftest import BUSY_S, until


def test_threads_get_the_lock_in_the_order_in_which_they_asked():
    lock, order = FairLock(BUSY_S), []

    def work(name):
        with lock:
            order.append(name)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(5)]
    with lock:
        for waiting, thread in enumerate(threads, 1):
            thread.start()
            until(lambda waiting=waiting: len(lock._waiting) == waiting)
        assert order == []
    for thread in threads:
        thread.join(BUSY_S)
    assert order == [0, 1, 2, 3, 4]


def test_a_slow_thread_loses_the_lock_and_its_end_releases_no_other():
    lock, slow_begun, slow_may_end, inside = FairLock(0.01), threading.Event(), threading.Event(), []

    def slow():
        with lock:
            slow_begun.set()
            slow_may_end.wait(BUSY_S)

    def third():
        with lock:
            inside.append("third")

    thread, other = threading.Thread(target=slow), threading.Thread(target=third)
    thread.start()
    assert slow_begun.wait(BUSY_S)
    with lock:  # while the slow one has not ended
        lock._max_hold_s = BUSY_S
        other.start()
        until(lambda: lock._waiting)
        slow_may_end.set()
        thread.join(BUSY_S)
        assert inside == []
    other.join(BUSY_S)
    assert inside == ["third"]
    with lock:
        pass


WORK = """
import threading, time
from tactiled.threads import run_on_thread

def start():
    run_on_thread(lambda: [time.sleep(1), print(1)])

sensor = threading.Thread(target=start, daemon=True)
sensor.start()
sensor.join()
"""


def test_the_interpreter_waits_for_work_on_a_thread():
    """A thread inside numpy that ends with the interpreter aborts the process."""
    done = subprocess.run([sys.executable, "-c", WORK], capture_output=True, timeout=BUSY_S, check=True)
    assert done.stdout == b"1\n"


COUNT_HEAPS = """
import ctypes, sys, tempfile, threading
from tactiled.threads import limit_heaps
if sys.argv[1] == "limited":
    limit_heaps()
together = threading.Barrier(9)
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
def work():
    together.wait()
    libc.malloc(100_000)
    together.wait()
for _ in range(8):
    threading.Thread(target=work).start()
for _ in range(2):
    together.wait()
libc.fopen.restype = ctypes.c_void_p
with tempfile.NamedTemporaryFile() as file:
    stream = ctypes.c_void_p(libc.fopen(file.name.encode(), b"w"))
    libc.malloc_info(0, stream)
    libc.fclose(stream)
    print(file.read().count(b"<heap nr="))
"""


@pytest.mark.parametrize(("how", "heaps"), [("limited", {2}), ("not", range(3, 100))])
def test_threads_share_two_heaps(how, heaps):
    text = subprocess.run([sys.executable, "-c", COUNT_HEAPS, how], capture_output=True, text=True, check=True)
    assert int(text.stdout) in heaps


def test_what_runs_beside_the_frames_runs_one_after_the_other():
    go_on, second = threading.Event(), threading.Event()
    run_on_thread(lambda: go_on.wait(BUSY_S))
    run_on_thread(second.set)
    assert not second.wait(0.05)
    go_on.set()
    assert second.wait(BUSY_S)
