import os
import signal

import pytest

from tactiled import processes
from tactiled.errors import ConfigError
from tactiled.processes import Cancelled, FitProcess, SideProcess
from tactiled.restore.methods import named
from tests.conftest import NICENESS, until


def test_a_function_runs_in_a_nicer_process_and_its_outcome_and_error_come_back(monkeypatch):
    monkeypatch.setattr(processes, "NICENESS", NICENESS)
    assert FitProcess().run(os.getpid) != os.getpid()
    assert NICENESS > 0
    assert FitProcess().run(os.nice, 0) == min(os.nice(0) + NICENESS, 19)
    with pytest.raises(ConfigError, match="no such method"):
        FitProcess().run(named, "sharpen")


def test_a_process_that_dies_is_an_error_and_a_cancelled_one_never_starts():
    with pytest.raises(RuntimeError, match="its process ended with code 3"):
        FitProcess().run(os._exit, 3)
    process = FitProcess()
    process.cancel()
    with pytest.raises(Cancelled):
        process.run(os.getpid)


def has_ended(process):
    try:
        os.waitpid(process, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def test_functions_run_in_one_process_that_has_its_errors_raised(monkeypatch):
    monkeypatch.setattr(processes, "NICENESS", NICENESS)
    side = SideProcess()
    assert side.run(os.nice, 0) == os.nice(0)  # a request waits for it
    first = side.run(os.getpid)
    assert first != os.getpid()
    with pytest.raises(ValueError, match="'three'"):
        side.run(int, "three")
    assert side.run(os.getpid) == first


@pytest.mark.parametrize("how", ["killed", "idle"])
def test_a_process_that_has_ended_is_started_again(how):
    side = SideProcess(idle_s=0.05 if how == "idle" else 60.0)
    first = side.run(os.getpid)
    if how == "killed":
        os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert side.run(os.getpid) != first


def test_work_that_kills_it_is_an_error_and_the_next_runs():
    side = SideProcess()
    with pytest.raises(RuntimeError, match="the process for abort ended with code -6"):
        side.run(os.abort)
    assert side.run(os.getpid)


def test_it_ends_with_the_last_reference():
    side = SideProcess()
    process = side.run(os.getpid)
    del side
    until(lambda: has_ended(process))
