"""Train the network of `tactiled.restore.learned`, on random scenes over arrays and covers of many kinds.

It is trained on no array and no scene of `tests.bench border` or `judge`, and on no cover of `border`; `judge` has
three that it saw, of 1, 2 and 3 pitches. A C compiler makes what takes the time, train_step.c.

The weights in the package took 120 minutes on one core in four runs, each from weights of the last (`--begin`), by
automatic differentiation, whose steps took eight times as long, without skins that are nearly as their models. The
last two had rates of 1e-3 and 8e-4, and drew large grids 2.2 and 4 times as often. 57 minutes more of what is here
(235 000 steps) did not make them better everywhere: `border` got worse with a cell a taxel. A fourth stage, 95
minutes (308 000 steps) from these weights on, made the first family of `judge` 2 % better and the second none.
"""

import ctypes
import subprocess
import time
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer

from tactiled.cover.kernel import cached, solve
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid, layout
from tactiled.restore.learned import (
    FIRMNESS,
    GAINS,
    INPUTS,
    KERNEL,
    OF_FRAME,
    WEIGHTS,
    Conditions,
    Weights,
    cell_maps,
)
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener
from tactiled.simulate.array import Surface
from tactiled.surface import CELLS_A_PITCH, make
from tests.bench.border import MATERIALS, OUTSIDE, hexagonal
from tests.bench.held_out_scenes import FINER
from tests.bench.training_scenes import training_scene

# Pitches of 1 mm. Thicknesses are of the covers that arrays are worn under, each in turn.
THICKNESSES = (0.35, 0.45, 0.6, 0.7, 0.85, 1.0, 1.25, 1.5, 1.75, 2.0, 2.3, 2.6, 3.0, 3.4, 4.0)
MAX_CELLS_THICK = 7.0  # thickness over the cell's side
GRIDS = (  # rows, columns, cells a pitch, whether the cover goes on beyond
    (5, 5, 1, True), (4, 8, 1, True), (9, 7, 1, True), (14, 14, 1, True), (24, 20, 1, True), (16, 20, 1, False),
    (8, 8, 1, False), (4, 4, 2, True), (5, 7, 2, True), (9, 9, 2, True), (6, 8, 2, False),
)  # fmt: skip
APERTURES = (0.9, 0.6, 0.75)  # pitches, each in turn
WRONG = (0.85, 0.95, 1.05, 1.15)  # times the thickness that the model has, of the covers of one scene in five
WRONG_SHARE, CUT_SHARE = 0.2, 0.35  # of scenes: under such a cover; that end at the array's border
FIELD, PRESSED = 18, 0.2  # pitches from a scene's middle in which the array is put; on pressure of so much
MIN_FRAME, MIN_INSIDE = 0.02, 0.1  # of the scene's peak: less on the taxels, or on the array's cells, is no sample
NOISE = (0.0005, 0.25)  # of the frame's peak, log-uniform
NOISE_ERROR = 0.07  # standard deviation of what is believed of the noise
COVERS, NEAR_COVERS = 8, 6  # of each array: of skins that may be wrong, and of such as are nearly as their models
DRAWS = 4  # of noise and faults, of one scene
FAULTY = 0.05  # share of frames with each: gains wrong, taxels out of place, taxels that read zero, a ceiling
GAIN_ERROR, PLACE_ERROR, DEAD, CEILING = 0.1, 0.3, 0.1, 0.5  # standard deviations, shares: at most
NEARLY = 0.96, 1.04  # times the thickness that the model has, of a skin that is nearly as its model
NEAR_SHARE, NEAR_ERROR = 0.2, 0.01  # of its frames with gains that are wrong by so much
STAGES, FILTERS, HIDDEN = 3, 24, 32
BLOCKS, LANES = 6, 8  # of a step: skins, and frames of each
RATE, LAST_RATE, WARM_UP, FORGET = 6e-4, 0.02, 500, 0.9995  # the last rate is a share of it
LARGE = (3, 4, 5), 2.5  # of GRIDS: are drawn so much more often
EARLIER, AROUND = 0.15, 0.1  # weights of the stages before the last, and of what lies beyond the array
FLOOR = 0.006  # relative error that counts as none
WITHIN, DOUBT, UNPRESSED = 0.96, 0.1, 0.1  # share of errors within two deviations; weights of these
TOUCHED = 0.02  # of the peak: cells with more are pressed
CLIP = 2.0  # norm of a gradient, at most


@cache
def arrays():
    """All that it is trained on: (array, cells a pitch)."""
    every = []
    for n, (rows, columns, refine, goes_on) in enumerate(GRIDS):
        array = grid(rows, columns, 1.0, APERTURES[n % 3])
        every.append((array if goes_on else replace(array, beyond=(0, 0, 0, 0)), refine))
    random = np.random.default_rng(11)
    y, x = np.mgrid[:5, :7]
    jittered = np.column_stack([x.ravel(), y.ravel()]) + random.uniform(-0.15, 0.15, (35, 2))
    triangle = np.array([[x + 0.5 * y, y * 3**0.5 / 2] for y in range(5) for x in range(5 - y)])
    gone = np.delete(hexagonal(7, 6), random.choice(42, 9, replace=False), axis=0)
    for n, places in enumerate((hexagonal(5, 5), jittered, triangle, gone)):
        every.append((layout(places, APERTURES[n % 3], "square"), CELLS_A_PITCH))
    return every


class Skin:
    """An array under a cover, one that its model is wrong about, and what the network sees of it."""

    def __init__(self, array, refine, thickness, material, random, nearly=False):
        self.array, self._faulty = array, nearly_right if nearly else faulty
        thin, wrong = (Stack((Layer(t, *MATERIALS[material]), Layer(1.0, 980.0, 0.3))) for t in
                       (thickness, thickness * random.choice(NEARLY if nearly else WRONG)))  # fmt: skip
        self.scene = Scene(make(cached(thin), array, refine), 1.0)  # in units of the noise
        self._wiener, self._conditions = Wiener(self.scene), Conditions(self.scene)
        self._exact, self._wrong = (self._sensed(solve(each, "layered")) for each in (thin, wrong))
        self.maps = cell_maps(self.scene)
        blur, places = self.scene.blur, array.positions
        self._half = np.ptp(places, axis=0) / 2 + 0.5
        side = blur.cell_mm
        rows, columns = blur.surface_shape
        surface = self._exact[0]
        row, column = (np.floor(each / side + n / 2) for each, n in ((surface.y, rows), (surface.x, columns)))
        self._on = ((row >= 0) & (row < rows) & (column >= 0) & (column < columns)).ravel()
        self._cell = (row * columns + column).ravel()[self._on].astype(int)
        modes = self.scene.modes
        self.bases = [np.asarray(each, np.float32) for each in (modes.gain, *modes.surface)]

    def _sensed(self, kernel):
        """The surface over the array and beyond it, and what its taxels sense of that."""
        shape, size = self.array.shape, self.array.size
        if shape is not None:
            far = grid(*(n + 2 * OUTSIDE for n in shape), 1.0, self.array.width)
            surface, own = Surface(kernel, far, FINER), (slice(OUTSIDE, -OUTSIDE),) * 2
            return surface, lambda fine: surface.sense(fine).reshape(far.shape)[own]
        low, high = self.array.positions.min(axis=0) - OUTSIDE, self.array.positions.max(axis=0) + OUTSIDE
        corners = np.vstack([self.array.positions, list(product(*zip(low, high, strict=True)))])
        surface = Surface(kernel, layout(corners, self.array.width, "square"), FINER)
        return surface, lambda fine: np.ravel(surface.sense(fine))[:size]

    def draw(self, random):
        """A noiseless frame and the truth (R, C), of a scene with the array somewhere on it."""
        inside = self.maps[1] > 0
        while True:
            seed, at = random.integers(1 << 62), np.arange(-FIELD, FIELD + 1.0)
            x, y = np.meshgrid(at, at)
            rough = training_scene(x, y, np.random.default_rng(seed)).ravel()
            pressed = np.flatnonzero(rough > PRESSED)
            if not len(pressed):
                continue
            n = random.choice(pressed)
            moved = np.array([x.flat[n], y.flat[n]]) - random.uniform(-1, 1, 2) * (self._half + 0.5)
            surface, sense = self._wrong if random.random() < WRONG_SHARE else self._exact
            fine = training_scene(surface.x + moved[0], surface.y + moved[1], np.random.default_rng(seed))
            if random.random() < CUT_SHARE or self.array.beyond is not None:
                fine = fine * ((np.abs(surface.x) < self._half[0]) & (np.abs(surface.y) < self._half[1]))
            frame = sense(fine)
            truth = np.bincount(self._cell, fine.ravel()[self._on], inside.size) / np.bincount(
                self._cell, minlength=inside.size
            )
            truth = truth.reshape(inside.shape)
            if frame.max() > MIN_FRAME and truth[inside].max() > MIN_INSIDE:
                return frame, truth

    def samples(self, count, random):
        """What the network sees of `count` frames, and the truths over the same scale."""
        every = []
        while len(every) < count:
            clean, truth = self.draw(random)
            for _ in range(DRAWS):
                frame = self._faulty(clean, random)
                noise = np.exp(random.uniform(*np.log(NOISE))) * frame.max()
                believed = noise * np.exp(random.normal(0, NOISE_ERROR))
                frame = (frame + noise * random.normal(size=frame.shape)) / believed
                *seen, scale = self.inputs(frame)
                every.append((*seen, 1 / scale, truth / (believed * scale)))
        return [np.array(each, np.float32) for each in zip(*every, strict=True)]

    def inputs(self, frame):
        """Give the linear image and coefficients of a frame, both over a scale, the conditions, and the scale."""
        self.scene.look(np.ascontiguousarray(frame, np.float32))
        linear = self._wiener()
        scale = self._conditions(self._wiener)
        return linear / scale, self.scene.c / scale, self._conditions.values.copy(), scale


def nearly_right(frame, random):
    """Give the frame as it is, or with gains that are slightly wrong."""
    return frame * (1 + NEAR_ERROR * random.normal(size=frame.shape)) if random.random() < NEAR_SHARE else frame


def faulty(frame, random):
    """Give the frame as it is, or with one kind of fault."""
    kind, size = random.random() / FAULTY, random.random()
    if kind < 1:
        return frame * (1 + GAIN_ERROR * size * random.normal(size=frame.shape))
    if kind < 2 and frame.ndim == 2:
        moves = PLACE_ERROR * size * random.normal(size=(2, *frame.shape))
        return frame + (moves * np.gradient(frame)).sum(axis=0)
    if 2 <= kind < 3:
        return frame * (random.random(frame.shape) > DEAD * size)
    if 3 <= kind < 4:
        return np.minimum(frame, (1 - CEILING * size) * frame.max())
    return frame


SAMPLES = "linear", "c", "conditions", "noise", "truths"
FIXED = "maps", "gain", "V", "W"  # of a skin


def skins(covers, seed, array=None, nearly=False):
    """Every array under some of the covers that are not too thick for its cells, right or nearly so."""
    for number, (taxels, refine) in enumerate(arrays()):
        thick = [each for each in THICKNESSES if each * refine <= MAX_CELLS_THICK]
        for n, thickness in enumerate(np.random.default_rng([seed, number]).permutation(thick)[:covers]):
            if array in (None, number):
                random = np.random.default_rng([seed, number, n, 1])
                yield (number, n), partial(Skin, taxels, refine, thickness, (n + number) % 2, random, nearly)


def samples(covers, frames, seed, cache, array=None, nearly=False):
    """Draw what is not in the folder yet: a file of samples for each skin. Gives the files."""
    cache.mkdir(parents=True, exist_ok=True)
    paths = []
    for (number, n), skin_of in skins(covers, seed, array, nearly):
        path = cache / f"{'near' if nearly else 'skin'}_{number}_{n}_{frames}_{seed}.npz"
        if not path.exists():
            skin = skin_of()
            fields = (*skin.samples(frames, np.random.default_rng([seed, number, n])), skin.maps, *skin.bases)
            np.savez(path, **dict(zip((*SAMPLES, *FIXED), fields, strict=True)))
        paths.append(path)
    return paths


def load(path):
    """Load the samples of a skin, float32."""
    with np.load(path) as stored:
        return {name: np.ascontiguousarray(stored[name], np.float32) for name in (*SAMPLES, *FIXED)}


def block(skin, random):
    """Choose LANES samples of a skin."""
    some = random.integers(len(skin["noise"]), size=LANES)
    return {name: skin[name][some] if name in SAMPLES else skin[name] for name in skin}


def network(w, inputs):
    """Give the images (S, B, R, C) of all stages, and the logarithm of the last one's deviation (B, R, C).

    `inputs` are those of a batch. Training has the same and its gradient in train_step.c.
    """
    linear, c, conditions, noise, maps, gain, V, W = inputs
    (size, rows, columns), (stages, filters) = linear.shape, w["redraw"].shape[:2]
    tuned = _hidden(w, conditions)[-1] @ w["tune"]
    tuned, doubt = tuned[:, :-1].reshape(size, stages, 2 * filters + 1), tuned[:, -1]
    consistent, redrawn, images, seen = np.maximum(linear, 0), linear, [], None
    edges, shifts = ((0, 0), (0, 0), (1, 1), (1, 1)), list(product(range(KERNEL), repeat=2))

    def drawn(kernels):
        """Add up what the filters' outputs are drawn with."""
        parts = np.pad((kernels @ seen.reshape(filters, -1)).reshape(-1, size, rows, columns), edges)
        summands = [parts[n, :, i : i + rows, j : j + columns] for n, (i, j) in enumerate(shifts)]
        return sum(summands[1:], summands[0])

    for stage in range(stages):
        padded = np.pad(np.stack([consistent, redrawn, linear, maps[:, 0], maps[:, 1]]), edges)
        around = np.concatenate([padded[:, :, i : i + rows, j : j + columns] for i, j in shifts])
        scale, offset = tuned[:, stage, :filters].T, tuned[:, stage, filters : 2 * filters].T
        seen = (w["redraw"][stage] @ around.reshape(len(around), -1)).reshape(filters, size, rows, columns)
        seen = np.maximum(seen * scale[:, :, None, None] + offset[:, :, None, None], 0)
        redrawn = consistent + drawn(w["draw"][stage])
        firm = (noise**2 * np.exp(FIRMNESS[0] * tuned[:, stage, -1] + FIRMNESS[1]))[:, None, None]
        missed = c - gain * (V.swapaxes(1, 2) @ redrawn @ W)
        consistent = redrawn + V @ (gain * missed / (gain**2 + firm)) @ W.swapaxes(1, 2)
        images.append(np.maximum(consistent, 0))
    return np.stack(images), drawn(w["doubt"]) + doubt[:, None, None]


def _hidden(w, conditions):
    """Give the conditions with ones, the hidden layer before it is cut off below zero, and after, with ones."""
    known = _with_ones(conditions)
    before = known @ w["hidden"]
    return known, before, _with_ones(np.maximum(before, 0))


def _with_ones(values):
    return np.concatenate([values, np.ones((len(values), 1), values.dtype)], axis=1)


@cache
def _step():
    """Compile train_step.c."""
    source = Path(__file__).with_name("train_step.c")
    with TemporaryDirectory() as folder:
        library = Path(folder) / "train_step.so"
        options = "-O3", "-march=native", "-funroll-loops", "-shared", "-fPIC"  # not -ffast-math: sets the process
        subprocess.run(["cc", *options, str(source), "-o", str(library), "-lm"], check=True)
        return ctypes.CDLL(str(library)).train_step


def step(w, blocks):
    """Give the loss' gradient, the relative errors of all stages (S, B), and pressed cells: all, and those within.

    The loss is the relative error's square over what the conditions let expect of it, which is learned along the
    way: where a frame may be of several scenes, their mean is right, not the likeliest, which may be a spike. The
    deviation is such that WITHIN of the errors lie within two of it, by the loss of that quantile.
    """
    known, before, hidden = _hidden(w, np.concatenate([each["conditions"] for each in blocks]))
    size, tuned = len(known), hidden @ w["tune"]
    weights = np.exp(-hidden @ w["expect"]) / size  # of an error's square
    stages = np.r_[np.full(STAGES - 1, EARLIER), 1].astype(np.float32)[:, None]
    terms = np.array([AROUND, TOUCHED, WITHIN, UNPRESSED, DOUBT / size, *FIRMNESS], np.float32)
    gradient = {name: np.zeros_like(each) for name, each in w.items()}
    to_tuned, squares, counts = np.zeros_like(tuned), np.empty((STAGES, size), np.float32), np.zeros(2, np.float32)
    for n, each in enumerate(blocks):
        own, (rows, columns) = slice(n * LANES, (n + 1) * LANES), each["gain"].shape
        errors, images = np.empty((STAGES, LANES), np.float32), np.empty((2, LANES, rows, columns), np.float32)
        arrays = (
            *(each[name] for name in ("linear", "c", "truths", "noise")), tuned[own], (stages * weights[own]),
            *(each[name] for name in FIXED), *(w[name] for name in ("redraw", "draw", "doubt")), terms,
            errors, counts, *images, *(gradient[name] for name in ("redraw", "draw", "doubt")), to_tuned[own],
        )  # fmt: skip
        assert all(array.dtype == np.float32 and array.flags.c_contiguous for array in arrays)
        if _step()(rows, columns, *(ctypes.c_void_p(array.ctypes.data) for array in arrays)):
            raise MemoryError
        squares[:, own] = errors
    to_expect = (stages * (1 / size - (squares + FLOOR**2) * weights)).sum(axis=0)
    gradient["tune"], gradient["expect"] = hidden.T @ to_tuned, hidden.T @ to_expect
    to_hidden = to_tuned @ w["tune"].T + np.outer(to_expect, w["expect"])
    gradient["hidden"] = known.T @ (to_hidden[:, :-1] * (before > 0))
    return gradient, np.sqrt(squares), counts


def start(random):
    """Give weights to begin from: filters that differ, and drawings and tunings near none."""
    conditions, tuned = OF_FRAME + len(GAINS), STAGES * (2 * FILTERS + 1) + 1
    w = {
        "redraw": random.normal(0, np.sqrt(2 / (KERNEL**2 * INPUTS)), (STAGES, FILTERS, KERNEL**2 * INPUTS)),
        "draw": random.normal(0, 0.1 / np.sqrt(KERNEL**2 * FILTERS), (STAGES, KERNEL**2, FILTERS)),
        "doubt": np.zeros((KERNEL**2, FILTERS)),
        "hidden": random.normal(0, 0.5, (conditions + 1, HIDDEN)),
        "tune": random.normal(0, 0.02, (HIDDEN + 1, tuned)),
    }
    w["expect"] = np.zeros(HIDDEN + 1)  # in training only
    w["hidden"][-1] = w["tune"][-1] = 0
    w["tune"][-1, :-1].reshape(STAGES, -1)[:, :FILTERS] = 1
    w["tune"][-1, -1] = -3
    return w


def fit(drawn, minutes, seed, w, report):
    """Train from `w` on for a time, by Adam, on skins `drawn` (share, samples); gives the last weights' mean."""
    random, names = np.random.default_rng(seed), list(w)
    flat = np.concatenate([np.ravel(w[name]) for name in names]).astype(np.float32)
    cuts, shapes = np.cumsum([np.size(w[name]) for name in names])[:-1], [np.shape(w[name]) for name in names]

    def parts(whole):
        pieces = zip(names, np.split(whole, cuts), shapes, strict=True)
        return {name: each.reshape(shape) for name, each, shape in pieces}

    w, mean, first, second = parts(flat), flat.copy(), np.zeros_like(flat), np.zeros_like(flat)
    shares, n, recent = np.array([share for share, _ in drawn]), 0, []
    began = reported = time.monotonic()
    while (share := (time.monotonic() - began) / (60 * minutes)) < 1:
        n += 1
        rate = RATE * min(1, n / WARM_UP) * max(LAST_RATE, (1 + np.cos(np.pi * share)) / 2)
        chosen = random.choice(len(drawn), size=BLOCKS, p=shares / shares.sum())
        gradient, errors, counts = step(w, [block(drawn[each][1], random) for each in chosen])
        slope = np.concatenate([np.ravel(gradient[name]) for name in names])
        slope *= min(1, CLIP / (np.linalg.norm(slope) + 1e-9))
        first += 0.1 * (slope - first)
        second += 0.01 * (slope**2 - second)
        flat -= rate * (first / (1 - 0.9**n)) / (np.sqrt(second / (1 - 0.99**n)) + 1e-8)
        mean += (1 - min(FORGET, n / (n + 10))) * (flat - mean)
        recent.append((errors[-1].mean(), *counts))
        if time.monotonic() - reported > 60:
            reported = time.monotonic()
            error, pressed, within = np.mean(recent[-5000:], axis=0)
            print(
                f"{share:.0%}, step {n}: error {error:.4f}, {within / pressed:.1%} within two deviations",
                flush=True,
            )
            report(parts(mean))
    return parts(mean)


def save(path, seen, w):
    """Write the weights, with the range (conditions) that the network saw."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = w | {"lowest": seen.min(axis=0), "highest": seen.max(axis=0)}
    np.savez_compressed(path, **{name: np.asarray(fields[name], np.float32) for name in Weights._fields})


def train(
    cache: Annotated[Path, typer.Argument(help="Folder that keeps the samples.")],
    frames: Annotated[int, typer.Option(help="Of each skin.")] = 1600,
    minutes: Annotated[float, typer.Option(help="How long to train.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    array: Annotated[int | None, typer.Option(help="Only draw the samples of this one.")] = None,
    begin: Annotated[Path | None, typer.Option(help="File of weights to go on from.")] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="File of weights.")] = WEIGHTS,
) -> None:
    """Train the learned restoration anew: writes tactiled/restore/learned.npz."""
    paths = samples(COVERS, frames, seed, cache, array)
    paths += samples(NEAR_COVERS, frames, seed, cache, array, nearly=True)
    if array is not None:
        return
    large, more = LARGE
    drawn = [(more if int(path.name.split("_")[1]) in large else 1.0, load(path)) for path in paths]
    print(f"{sum(len(each['noise']) for _, each in drawn)} samples", flush=True)
    seen = np.concatenate([each["conditions"] for _, each in drawn])
    w = start(np.random.default_rng([seed, 1]))
    if begin:
        w |= {name: each for name, each in np.load(begin).items() if name in w}
    report = partial(save, output, seen)
    report(fit(drawn, minutes, seed, w, report))
