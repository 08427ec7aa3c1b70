from time import process_time

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from tactiled.cover.stack import Layer, Stack
from tactiled.study.cover import PAPER, random_stack, sweep, times, trial


def test_every_stack_of_a_short_sweep_reaches_the_aim():
    trials = list(sweep(12, seed=3))
    assert not [one.refusal for one in trials if one.refusal]
    assert max(one.error for one in trials) <= 1e-3
    assert max(one.ratio for one in trials) <= 2


def test_a_sweep_is_the_same_again():
    first, second = ([random_stack(rng) for _ in range(5)] for rng in map(np.random.default_rng, (4, 4)))
    assert first == second


def test_random_stacks_cover_the_ranges():
    rng = np.random.default_rng(1)
    stacks = [random_stack(rng) for _ in range(500)]
    layers = [layer for stack in stacks for layer in stack.layers]
    lowest = [stack.layers[-1].young for stack in stacks if len(stack.layers) > 1]
    assert {len(stack.layers) for stack in stacks} == {1, 2, 3, 4}
    assert {(len(stack.layers), stack.sensing) for stack in stacks} >= {(4, 1), (4, 4), (1, 1)}
    for values, low, high in (
        ([layer.thickness for layer in layers], 0.05, 10),
        ([layer.young for stack in stacks for layer in stack.layers[:-1]], 0.05, 10_000),
        (lowest, 1, 200_000),
    ):
        assert low <= min(values) < 1.1 * low
        assert high / 1.1 < max(values) <= high
    assert min(layer.poisson for layer in layers) < 0.01
    assert max(layer.poisson for layer in layers) == pytest.approx(0.4999, abs=1e-5)


def test_a_stack_that_is_refused_says_why():
    told = trial(Stack((Layer(1.0, 1e16, 0.3), Layer(1.0, 1.0, 0.49))))
    assert "singular" in told.refusal
    assert np.isnan(told.error)


def test_a_wrong_gain_is_told(monkeypatch):
    monkeypatch.setattr("tactiled.study.cover.layered.gain", lambda _, q: np.full_like(q, 0.5))
    assert trial(PAPER).error == pytest.approx(0.5, abs=0.01)


def test_the_papers_cover_takes_little_of_one_core(monkeypatch):
    monkeypatch.setattr("tactiled.study.cover.perf_counter", process_time)  # of this process, whatever else runs
    with threadpool_limits(1):
        taken = times()
    assert taken.cold < 0.3
    assert taken.warm < 0.005
    assert taken.exact < 0.005
