"""A generator in a process with bounds: its items in order, and its end whatever it does."""

import logging
import os
import subprocess
import sys
import time
from itertools import count, islice
from pathlib import Path
from threading import Timer

import pytest

from tactiled.bus.bounded_process import BoundedProcess, Bounds, Exceeded
from tests.conftest import until

BOUNDS = Bounds(cpu_s=20.0, memory_mb=100.0)
ZEROS = iter(int, 1)  # without end; itertools have no pickles since Python 3.14
ORPHAN = """
import os
from tactiled.bus.bounded_process import BoundedProcess, Bounds, _Worker
items = iter(BoundedProcess(Bounds(600.0, 100.0), map, (2).__pow__, range(10**9)))
next(items)
next(items)  # from here on it works ahead: one number at a time, each larger
print(items.gi_frame.f_locals["worker"]._process.pid, flush=True)
os._exit(0)
"""


def pid():
    """That of the process which runs the next generator."""
    (stat,) = BoundedProcess(BOUNDS, map, Path.read_text, [Path("/proc/self/stat")])
    return int(stat.split()[0])


def test_items_come_in_order_and_those_before_an_error_before_it():
    assert list(BoundedProcess(BOUNDS, range, 5000)) == list(range(5000))
    items, values = [], [*range(1, 3000), 0, 1]
    with pytest.raises(ZeroDivisionError):
        items.extend(BoundedProcess(BOUNDS, map, (6000).__divmod__, values))
    assert items == [divmod(6000, each) for each in range(1, 3000)]


def test_one_process_serves_one_generator_after_the_other_and_ends_with_no_harm():
    first = pid()
    assert next(iter(BoundedProcess(BOUNDS, count, 7))) == 7  # and nothing more is made of it
    assert pid() == first
    assert list(islice(BoundedProcess(BOUNDS, count), 3000)) == list(range(3000))  # it is ahead, and is ended
    other = pid()
    assert other != first
    os.kill(other, 9)
    assert pid() not in (first, other)


def test_what_makes_no_progress_is_ended():
    began = time.process_time()
    with pytest.raises(Exceeded, match="nothing comes of it in 1 s of processor time"):
        list(BoundedProcess(Bounds(1.0, 100.0), filter, None, ZEROS))  # never gives Python a turn
    assert time.process_time() - began < 0.5


def test_progress_needs_no_end():
    slow = [range(3_000_000)] * 25  # 2 s of processor time in all
    assert len(list(BoundedProcess(Bounds(1.0, 100.0), map, sum, slow))) == 25


def test_memory_is_bounded():
    with pytest.raises(MemoryError):
        list(BoundedProcess(BOUNDS, map, bytes, [10**6, 2 * 10**8]))
    assert len(list(BoundedProcess(BOUNDS._replace(memory_mb=500.0), map, len, map(bytes, [2 * 10**8])))) == 1


def test_it_logs_nothing(capfd):
    assert list(BoundedProcess(BOUNDS, map, logging.error, ["a line of a library"] * 2)) == [None, None]
    assert capfd.readouterr() == ("", "")


def test_it_is_cancelled_before_it_begins_and_while_it_is_waited_for():
    endless = BoundedProcess(BOUNDS, filter, None, ZEROS)
    timer = Timer(0.3, endless.cancel)
    timer.start()
    with pytest.raises(Exceeded, match="cancelled"):
        list(endless)
    timer.join()
    with pytest.raises(Exceeded, match="cancelled"):
        list(endless)


def test_it_ends_with_its_parent():
    command = [sys.executable, "-c", ORPHAN]
    orphan = int(subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout)
    until(lambda: not Path(f"/proc/{orphan}").exists())
