import os
import signal
import time

import pytest

from tactiled.runtime.side_process import SideProcess
from tests.conftest import until


def fail(value):
    raise ValueError(f"not {value}")


def process_id():
    return os.getpid()


def has_ended(process):
    try:
        os.waitpid(process, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def test_functions_run_in_one_process_that_has_its_errors_raised():
    side = SideProcess()
    first = side.run(process_id)
    assert first != os.getpid()
    with pytest.raises(ValueError, match="not 3"):
        side.run(fail, 3)
    assert side.run(process_id) == first


@pytest.mark.parametrize("how", ["killed", "idle"])
def test_a_process_that_has_ended_is_started_again(how):
    side = SideProcess(idle_s=0.05 if how == "idle" else 60.0)
    first = side.run(process_id)
    if how == "killed":
        os.kill(first, signal.SIGKILL)
    else:
        time.sleep(0.3)
    assert side.run(process_id) != first


def test_work_that_kills_it_is_an_error_and_the_next_runs():
    side = SideProcess()
    with pytest.raises(RuntimeError, match="the process for abort ended with code -6"):
        side.run(os.abort)
    assert side.run(process_id)


def test_it_ends_with_the_last_reference():
    side = SideProcess()
    process = side.run(process_id)
    del side
    until(lambda: has_ended(process))
