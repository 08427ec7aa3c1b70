from time import process_time

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from tests.bench.cover import PAPER, sweep, times_s, trial


def test_every_stack_of_a_short_sweep_reaches_the_aim():
    trials = sweep(6, seed=3)
    assert not [each.refusal for each in trials if each.refusal]
    assert max(each.error for each in trials) <= 1e-3
    assert max(each.ratio for each in trials) <= 2


def test_wrong_gains_are_reported(monkeypatch):
    monkeypatch.setattr("tests.bench.cover.layered.gain", lambda _, q: np.full_like(q, 0.5))
    assert trial(PAPER).error == pytest.approx(0.5, abs=0.01)


def test_the_papers_cover_takes_less_than_the_aims(monkeypatch):
    monkeypatch.setattr("tests.bench.cover.perf_counter", process_time)  # of this process, whatever else runs
    with threadpool_limits(1):
        _, cold, warm, exact = times_s()
    assert cold < 0.3
    assert warm < 0.005
    assert exact < 0.005
