"""Train the network of `tactiled.restore.learned`, on scenes drawn at random under covers of many thicknesses.

Needs JAX (pip install 'tactiled[train]'), as nothing else here does. The weights in the package: learned.npz took
57 minutes on one core, 35 with the error's logarithm as the loss and 22 with the error over what is expected, both
with 1 % of error in a fifth of the gains, covers 4 % off in a fifth of the frames, and no other fault.
learned_wary.npz went on from there for 15 minutes, as below: --scenes 18000 --seed 4 --start learned.npz.
"""

import time
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from tactiled.restore.learned import FIRMNESS, GAINS, INPUTS, KERNEL, OF_FRAME, WEIGHTS, Conditions, Weights
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener
from tactiled.study.skin import cell_means, rubber
from tests.study.held_out_scenes import FINER
from tests.study.presses import PAPER
from tests.study.training_scenes import SIDE, training_scene

THICKNESSES = (0.35, 0.5, 0.7, 0.85, 1.0, 1.25, 1.5, 1.75, 2.0, 2.3, 2.6, 3.0, 3.4, 4.0)  # pitches
WRONG = (0.85, 0.95, 1.05, 1.15)  # times the thickness that the model has, of one cover in five
BEYOND, OVER_EDGE = 12, 0.1  # taxels more along each side of a scene that reaches over the edge; share of these
MIN_INSIDE = 0.3  # of the force of a scene that reaches over the edge: less leaves little to restore
COVERS_A_SCENE = 2
MIN_FRAME = 0.02  # of the scene's peak: a fainter frame is not worth a sample
NOISE = (0.0005, 0.25)  # of the frame's peak, log-uniform
NOISE_ERROR = 0.07  # standard deviation of what is believed of the noise
FAULTY = 0.05  # share of the frames with each of these: gains wrong, taxels out of place, taxels that read zero
GAIN_ERROR, PLACE_ERROR, DEAD = 0.1, 0.3, 0.1  # standard deviation, the same in pitches, share: at most
STAGES, FILTERS, HIDDEN = 3, 16, 24
BATCH, RATE, WARM_UP, FORGET = 32, 2e-3, 200, 0.998
EARLIER = 0.15  # weight of the stages before the last
FLOOR = 0.006  # relative error that counts as none
CLIP = 2.0  # norm of a gradient, at most


class Cover:
    """A skin, one with a thickness that its model does not have, and what one frame of it is to the network."""

    def __init__(self, thickness, material):
        self.skin = rubber(thickness, SIDE, FINER, **material)
        self.wrong = [rubber(thickness * each, SIDE, FINER, **material).surface for each in WRONG]
        self.larger = rubber(thickness, SIDE + BEYOND, FINER, **material)
        self.scene = Scene(self.skin.blur, 1.0)  # in units of the noise
        self._wiener, self._conditions = Wiener(self.scene), Conditions(self.scene)
        modes = self.scene.modes
        self.bases = [np.asarray(each, np.float32) for each in (modes.gain, *modes.surface)]

    def inputs(self, frame):
        """Give the linear image and coefficients of a frame, both over a scale, the conditions, and the scale."""
        self.scene.look(np.ascontiguousarray(frame, np.float32))
        linear = self._wiener()
        scale = max(float(linear.max()), 1.0)
        conditions = self._conditions(linear, self._wiener.noise_gain, scale).copy()
        return linear / scale, self.scene.c / scale, conditions, scale


def covers():
    """Rubber and the paper's film, of all THICKNESSES."""
    return [Cover(*each) for each in product(THICKNESSES, ({}, PAPER))]


def samples(skins, count, seed, cache=None):
    """Give the covers (n,), noiseless frames and truths (n, SIDE, SIDE) of `count` scenes, or look them up."""
    path = cache and cache / f"samples_{count}_{seed}.npz"
    if path and path.exists():
        return tuple(np.load(path).values())
    random, (of_cover, frames, truths) = np.random.default_rng(seed), ([], [], [])
    for _ in range(count):
        over_edge = random.random() < OVER_EDGE
        skin = skins[0].larger if over_edge else skins[0].skin
        fine = training_scene(skin.surface.x, skin.surface.y, random)
        i, j = random.integers(0, BEYOND + 1, 2) * over_edge
        part = slice(i, i + SIDE), slice(j, j + SIDE)
        everything = cell_means(skin, fine)
        truth = everything[part]
        if truth.sum() < MIN_INSIDE * everything.sum():
            continue
        for n in random.choice(len(skins), min(COVERS_A_SCENE, len(skins)), replace=False):
            exact = (skins[n].larger if over_edge else skins[n].skin).surface
            if not over_edge and random.random() < 0.2:
                exact = skins[n].wrong[random.integers(len(WRONG))]
            frame = exact.sense(fine).reshape(skin.array.frame_shape)[part]
            if frame.max() > MIN_FRAME * truth.max():
                for each, value in zip((of_cover, frames, truths), (n, frame, truth), strict=True):
                    each.append(value)
    data = np.array(of_cover), np.array(frames, np.float32), np.array(truths, np.float32)
    if path:
        np.savez(path, *data)
    return data


def faulty(frame, random):
    """Give the frame as it is, or with one kind of fault."""
    kind, size = random.random() / FAULTY, random.random()
    if kind < 1:
        return frame * (1 + GAIN_ERROR * size * random.normal(size=frame.shape))
    if kind < 2:
        moves = PLACE_ERROR * size * random.normal(size=(2, *frame.shape))
        return frame + (moves * np.gradient(frame)).sum(axis=0)
    if kind < 3:
        return frame * (random.random(frame.shape) > DEAD * size)
    return frame


def batch(skins, data, random, size=BATCH):
    """Draw samples, turn and mirror them, add noise, and give what the network sees of them with the truth."""
    indices = random.integers(len(data[0]), size=size)
    inputs, truths = [], []
    for n in indices:
        turn = [(1, 1), (1, -1), (-1, 1), (-1, -1)][random.integers(4)]
        frame, truth = (each[n][:: turn[0], :: turn[1]] for each in data[1:])
        if random.random() < 0.5:
            frame, truth = frame.T, truth.T
        noise = np.exp(random.uniform(*np.log(NOISE))) * frame.max()
        frame = faulty(frame, random)
        believed = noise * np.exp(random.normal(0, NOISE_ERROR))
        *seen, scale = skins[data[0][n]].inputs((frame + noise * random.normal(size=frame.shape)) / believed)
        inputs.append((*seen, 1 / scale, *skins[data[0][n]].bases))
        truths.append(truth / (believed * scale))
    return tuple(np.array(each, np.float32) for each in zip(*inputs, strict=True)), np.array(truths, np.float32)


def network(w, inputs, xp=np):
    """Give the images (S, B, R, C) of all stages; `inputs` are those of `batch`, `xp` is numpy or jax.numpy."""
    linear, c, conditions, noise, gain, V, W = inputs
    (size, rows, columns), (stages, filters) = linear.shape, w["redraw"].shape[:2]
    tuned = (_hidden(w, conditions, xp) @ w["tune"]).reshape(size, stages, 2 * filters + 1)
    consistent, redrawn, images = xp.maximum(linear, 0), linear, []
    for stage in range(stages):
        if stage:
            firm = (noise**2 * xp.exp(FIRMNESS[0] * tuned[:, stage - 1, -1] + FIRMNESS[1]))[:, None, None]
            missed = c - gain * (V.swapaxes(1, 2) @ redrawn @ W)
            consistent = redrawn + V @ (gain * missed / (gain**2 + firm)) @ W.swapaxes(1, 2)
        padded = xp.pad(xp.stack([consistent, redrawn, linear]), ((0, 0), (0, 0), (1, 1), (1, 1)))
        shifts = list(product(range(KERNEL), repeat=2))
        around = xp.concatenate([padded[:, :, i : i + rows, j : j + columns] for i, j in shifts])
        scale, offset = tuned[:, stage, :filters].T, tuned[:, stage, filters : 2 * filters].T
        seen = (w["redraw"][stage] @ around.reshape(len(around), -1)).reshape(filters, size, rows, columns)
        seen = xp.maximum(seen * scale[:, :, None, None] + offset[:, :, None, None], 0)
        maps = (w["draw"][stage] @ seen.reshape(filters, -1)).reshape(-1, size, rows, columns)
        maps = xp.pad(maps, ((0, 0), (0, 0), (1, 1), (1, 1)))
        summands = [maps[n, :, i : i + rows, j : j + columns] for n, (i, j) in enumerate(shifts)]
        redrawn = consistent + sum(summands[1:], summands[0])
        images.append(xp.maximum(redrawn, 0))
    return xp.stack(images)


def errors(images, truths, xp=np):
    """Relative errors (S, B)."""
    return xp.sqrt(xp.sum((images - truths) ** 2, axis=(2, 3)) / xp.sum(truths**2, axis=(1, 2)))


def _hidden(w, conditions, xp):
    hidden = xp.maximum(_with_ones(conditions, xp) @ w["hidden"], 0)
    return _with_ones(hidden, xp)


def _with_ones(values, xp):
    return xp.concatenate([values, xp.ones((len(values), 1))], axis=1)


def _start(random):
    """Give weights to begin from: filters that differ, and drawings and tunings near none."""
    conditions, tuned = OF_FRAME + len(GAINS), STAGES * (2 * FILTERS + 1)
    w = {
        "redraw": random.normal(0, np.sqrt(2 / (KERNEL**2 * INPUTS)), (STAGES, FILTERS, KERNEL**2 * INPUTS)),
        "draw": random.normal(0, 0.1 / np.sqrt(KERNEL**2 * FILTERS), (STAGES, KERNEL**2, FILTERS)),
        "hidden": random.normal(0, 0.5, (conditions + 1, HIDDEN)),
        "tune": random.normal(0, 0.02, (HIDDEN + 1, tuned)),
    }
    w["expect"] = np.zeros(HIDDEN + 1)  # in training only
    w["hidden"][-1] = w["tune"][-1] = 0
    w["tune"][-1].reshape(STAGES, -1)[:, :FILTERS] = 1
    return w


def fit(skins, data, minutes, seed, start):
    """Train from `start` on for a time; gives the weights, averaged over the last steps.

    The loss is the relative error's square over what the conditions let expect of it, which is learned along the
    way: where a frame may be of several scenes, their mean is right, not the likeliest, which may be a spike.
    """
    import jax
    import jax.numpy as jnp

    def loss(w, inputs, truths):
        each = errors(network(w, inputs, jnp), truths, jnp)
        expected = _hidden(w, inputs[2], jnp) @ w["expect"]  # its square's logarithm
        over = ((each**2 + FLOOR**2) * jnp.exp(-expected) + expected).mean(axis=1)
        return over[-1] + EARLIER * over[:-1].sum(), each[-1].mean()

    @jax.jit
    def step(state, n, rate, inputs, truths):
        w, first, second, mean = state
        (_, error), gradient = jax.value_and_grad(loss, has_aux=True)(w, inputs, truths)
        norm = jnp.sqrt(sum(jnp.vdot(each, each) for each in jax.tree.leaves(gradient)))
        gradient = jax.tree.map(lambda g: g * jnp.minimum(1, CLIP / (norm + 1e-9)), gradient)
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, gradient)
        second = jax.tree.map(lambda v, g: 0.99 * v + 0.01 * g**2, second, gradient)
        move = partial(_adam, n, rate, jnp)
        w = jax.tree.map(move, w, first, second)
        return (w, first, second, jax.tree.map(lambda a, b: FORGET * a + (1 - FORGET) * b, mean, w)), error

    random = np.random.default_rng(seed)
    w = {name: jnp.asarray(each, jnp.float32) for name, each in start.items()}
    none = jax.tree.map(jnp.zeros_like, w)
    state, n, recent = (w, none, none, w), 0, []
    began = reported = time.monotonic()
    while (share := (time.monotonic() - began) / (60 * minutes)) < 1:
        n += 1
        rate = RATE * min(1, n / WARM_UP) * (1 + np.cos(np.pi * share)) / 2
        state, error = step(state, float(n), rate, *batch(skins, data, random))
        recent.append(float(error))
        if time.monotonic() - reported > 60:
            reported = time.monotonic()
            print(f"{share:.0%}, step {n}: relative error {np.mean(recent[-1000:]):.4f}", flush=True)
    return {name: np.asarray(each, np.float32) for name, each in state[3].items()}


def _adam(n, rate, xp, w, first, second):
    return w - rate * (first / (1 - 0.9**n)) / (xp.sqrt(second / (1 - 0.99**n)) + 1e-8)


def save(w, path, seen):
    """Write the weights, with the range (conditions) that the network saw."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    fields = w | {"lowest": seen.min(axis=0), "highest": seen.max(axis=0)}
    np.savez_compressed(path, **{name: np.asarray(fields[name], np.float32) for name in Weights._fields})


def train(
    scenes: Annotated[int, typer.Option(help="How many to draw.")] = 40000,
    minutes: Annotated[float, typer.Option(help="How long to train.")] = 40.0,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    start: Annotated[Path | None, typer.Option(help="File of weights to go on from.")] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="File of weights.")] = WEIGHTS,
    cache: Annotated[Path | None, typer.Option(help="Folder that keeps the samples.")] = None,
) -> None:
    """Train the learned restoration anew: writes tactiled/restore/learned.npz. Needs jax."""
    skins = covers()
    data = samples(skins, scenes, seed, cache)
    print(f"{len(data[0])} samples", flush=True)
    random = np.random.default_rng([seed, 1])
    seen = np.concatenate([batch(skins, data, random)[0][2] for _ in range(100)])
    weights = _start(random)
    if start:
        weights |= {name: each for name, each in np.load(start).items() if name in weights}
    save(fit(skins, data, minutes, seed, weights), output, seen)
