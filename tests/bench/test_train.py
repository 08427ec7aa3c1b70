import numpy as np
import pytest

from tests.bench import train


def loss(w, blocks, around):
    """The mean over blocks, in double precision; what the deviation is compared with is that of `around`."""
    total = 0.0
    for each in blocks:
        each = {name: values.astype(float) for name, values in each.items()}
        fixed = (np.repeat(each[name][None], train.LANES, axis=0) for name in train.FIXED)
        inputs = (*(each[name] for name in ("linear", "c", "conditions", "noise")), *fixed)
        images, doubts = train.network(w, inputs)
        (near, *_), inside, truths = train.network(around, inputs)[0][::-1], inputs[4][:, 1], each["truths"]
        weight = inside + train.AROUND * (1 - inside)
        squares = (weight * (images - truths) ** 2).sum((2, 3)) / (weight * truths**2).sum((1, 2))
        expected = (
            np.c_[np.maximum(np.c_[each["conditions"], np.ones(8)] @ w["hidden"], 0), np.ones(8)] @ w["expect"]
        )
        over = ((squares + train.FLOOR**2) * np.exp(-expected) + expected).mean(axis=1)
        missed = np.log(np.abs(near - truths) + 1e-5) - doubts - np.log(2)
        pressed = truths > train.TOUCHED * truths.max(axis=(1, 2), keepdims=True)
        weight = inside * np.where(pressed, 1, train.UNPRESSED)
        quantile = weight * np.maximum(train.WITHIN * missed, (train.WITHIN - 1) * missed)
        quantile = (quantile.sum((1, 2)) / weight.sum((1, 2))).mean()
        total += over[-1] + train.EARLIER * over[:-1].sum() + train.DOUBT * quantile
    return total / len(blocks)


def test_a_step_follows_the_slope_of_the_loss_of_the_network(tmp_path):
    random = np.random.default_rng(3)
    w = train.start(random)
    for each in w.values():
        each += random.normal(0, 0.02, each.shape)
    paths = [train.samples(1, train.LANES, 5, tmp_path, array)[0] for array in (0, 7)]
    blocks = [train.load(path) for path in paths]
    gradient, errors, (pressed, within) = train.step({name: np.float32(each) for name, each in w.items()}, blocks)
    assert errors.shape == (train.STAGES, 2 * train.LANES)
    assert 0 < within < pressed
    for name, slope in gradient.items():
        way = random.normal(size=slope.shape)
        ahead, back = (w | {name: w[name] + sign * 1e-6 * way} for sign in (1, -1))
        change = (loss(ahead, blocks, w) - loss(back, blocks, w)) / 2e-6
        assert (slope * way).sum() == pytest.approx(change, rel=1e-2, abs=1e-3 * float(np.linalg.norm(slope))), (
            name
        )
