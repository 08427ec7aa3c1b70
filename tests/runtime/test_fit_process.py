import os

import pytest

from tactiled.errors import ConfigError
from tactiled.restore.methods import named
from tactiled.runtime import fit_process
from tactiled.runtime.fit_process import Cancelled, FitProcess
from tests.conftest import NICENESS


def test_a_function_runs_in_a_nicer_process_and_its_outcome_and_error_come_back(monkeypatch):
    monkeypatch.setattr(fit_process, "NICENESS", NICENESS)
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
