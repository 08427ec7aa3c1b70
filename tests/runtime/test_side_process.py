import os
import signal

import pytest

from tactiled.runtime.side_process import SideProcess
from tests.conftest import until


def has_ended(process):
    try:
        os.waitpid(process, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def test_functions_run_in_one_process_that_has_its_errors_raised():
    side = SideProcess()
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
