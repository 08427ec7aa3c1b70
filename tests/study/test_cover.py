from time import process_time

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from tactiled.cover.stack import Layer, Stack
from tests.study.cover import PAPER, random_stack, sweep, times_s, trial


def test_every_stack_of_a_short_sweep_reaches_the_aim():
    trials = sweep(12, seed=3)
    assert not [each.refusal for each in trials if each.refusal]
    assert max(each.error for each in trials) <= 1e-3
    assert max(each.ratio for each in trials) <= 2


def test_random_stacks_cover_the_ranges():
    rng = np.random.default_rng(1)
    stacks = [random_stack(rng) for _ in range(500)]
    layers = [layer for stack in stacks for layer in stack.layers]
    assert {len(stack.layers) for stack in stacks} == {1, 2, 3, 4}
    assert {(len(stack.layers), stack.sensing) for stack in stacks} >= {(4, 1), (4, 4), (1, 1)}
    for values, low, high in (
        ([layer.thickness for layer in layers], 0.05, 10),
        ([layer.young for stack in stacks for layer in stack.layers[:-1]], 0.05, 10_000),
        ([stack.layers[-1].young for stack in stacks if len(stack.layers) > 1], 1, 200_000),
    ):
        assert low <= min(values) < 1.1 * low
        assert high / 1.1 < max(values) <= high
    assert min(layer.poisson for layer in layers) < 0.01
    assert max(layer.poisson for layer in layers) == pytest.approx(0.4999, abs=1e-5)


def test_refused_stacks_and_wrong_gains_are_reported(monkeypatch):
    assert "singular" in trial(Stack((Layer(1.0, 1e16, 0.3), Layer(1.0, 1.0, 0.49)))).refusal
    monkeypatch.setattr("tests.study.cover.layered.gain", lambda _, q: np.full_like(q, 0.5))
    assert trial(PAPER).error == pytest.approx(0.5, abs=0.01)


def test_the_papers_cover_takes_less_than_the_aims(monkeypatch):
    monkeypatch.setattr("tests.study.cover.perf_counter", process_time)  # of this process, whatever else runs
    with threadpool_limits(1):
        _, cold, warm, exact = times_s()
    assert cold < 0.3
    assert warm < 0.005
    assert exact < 0.005
