"""What others' methods reach at best: each tuned for every press with the truth known, which no user has."""

import json
from functools import cache
from hashlib import sha256
from os import getpid
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tactiled.bench.peers import skimage_rl, skimage_wiener
from tactiled.bench.skin import nrmse

VERSION = 1  # of this file: change it when an error may change, so that none is looked up that it does not give
PEERS = {
    "W*": "scikit-image wiener",
    "RL*": "scikit-image richardson_lucy",
    "NNT*": "non-negative Tikhonov",
    "TV*": "non-negative total variation",
}
BALANCES = tuple(10.0 ** (0.5 * n) for n in range(-12, 5))  # of scikit-image's wiener
STOPS = (1, 2, 3, 5, 8, 12, 20, 30, 50, 80, 120, 200, 400)  # iterations of its richardson_lucy
# Weights for frames with a peak of 1. Ten times the iterations change a tuned error by under 1 and 3 %, but for TV
# in the least noise under t/pitch 3, where Tikhonov is better.
TIKHONOV_WEIGHTS, TIKHONOV_ITERATIONS = 10.0 ** np.arange(-5.5, 0.1, 0.5), 300
TV_WEIGHTS, TV_ITERATIONS = 10.0 ** np.arange(-5.5, -0.9, 0.5), 400
# The blur by its modes is wrong by one to three per cent, which shows under less noise than EXACT_NOISE: there the
# iterations go on from the best weight and its neighbours with the matrix itself.
EXACT_NOISE, EXACT_CELLS, EXACT_ITERATIONS = 0.015, 1024, 120
OVERRELAXATION = 1.7
DUAL_SHARE = 0.1  # of the primal step in the step that suits a contrast of 1: converges fastest of 0.1 to 10


class Operator(NamedTuple):
    """H = U diag(s) V' of a grid, on batches of images (weights, R, C)."""

    squares: np.ndarray  # s^2
    of_data: object  # V' H' y
    analyse: object  # V' x
    synthesise: object  # V c


@cache
def by_modes(blur):
    """H by the modes that our methods restore with, too."""
    (Uy, Ux), (Vy, Vx) = ([b.astype(np.float32) for b in each] for each in (blur.modes.taxel, blur.modes.surface))
    gain = blur.modes.gain.astype(np.float32)
    return Operator(gain**2, lambda y: gain * (Uy.T @ y @ Ux), lambda x: Vy.T @ x @ Vx, lambda c: Vy @ c @ Vx.T)


@cache
def by_matrix(blur):
    """H by all its singular vectors."""
    shape, cells = blur.surface_shape, int(np.prod(blur.surface_shape))
    H = blur.forward(np.eye(cells).reshape(-1, *shape)).reshape(cells, -1).T
    squares, V = np.linalg.eigh(H.T @ H)
    H, V = H.astype(np.float32), V.astype(np.float32)
    return Operator(
        np.maximum(squares, 0).astype(np.float32),
        lambda y: (y.ravel() @ H) @ V,
        lambda x: x.reshape(len(x), -1) @ V,
        lambda c: (c @ V.T).reshape(-1, *shape),
    )


def _per_weight(values, H):
    """Numbers (weights,) against coefficients."""
    return np.asarray(values, np.float32).reshape(-1, *[1] * H.squares.ndim)


def tikhonov(H, y, weights, iterations, state=None):
    """min |H x - y|^2 / 2 + w |x|^2 / 2, x >= 0, by over-relaxed ADMM; every weight at once. Gives x first."""
    w, at = _per_weight(weights, H), H.of_data(y)
    penalty = np.sqrt(w * (1 + w))
    inverse = 1 / (H.squares + w + penalty)
    z, u = state or np.zeros((2, len(weights), *y.shape), np.float32)
    for _ in range(iterations):
        x = H.synthesise((at + penalty * H.analyse(z - u)) * inverse)
        x = OVERRELAXATION * x + (1 - OVERRELAXATION) * z
        z = np.maximum(x + u, 0)
        u = u + x - z
    return z, u


def total_variation(H, y, weights, iterations, state=None):
    """min |H x - y|^2 / 2 + w TV(x), isotropic, x >= 0, by Chambolle and Pock; every weight at once."""
    w = np.asarray(weights, np.float32)[:, None, None]
    step = DUAL_SHARE / (3 * w)
    dual_step = 1 / (9 * step)  # |differences|^2 <= 8, and the identity of x >= 0
    at, inverse = _per_weight(step, H) * H.of_data(y), 1 / (1 + _per_weight(step, H) * H.squares)
    state = state or np.zeros((5, len(weights), *y.shape), np.float32)
    x, ahead, right, down, below = (each.copy() for each in state)
    for _ in range(iterations):
        right[:, :, :-1] += dual_step * np.diff(ahead, axis=2)
        down[:, :-1] += dual_step * np.diff(ahead, axis=1)
        cut = np.minimum(1, w / np.maximum(np.hypot(right, down), 1e-30))
        right *= cut
        down *= cut
        below = np.minimum(below + dual_step * ahead, 0)
        pull = below - right - down
        pull[:, :, 1:] += right[:, :, :-1]
        pull[:, 1:] += down[:, :-1]
        before, x = x, H.synthesise((H.analyse(x - step * pull) + at) * inverse)
        ahead = 2 * x - before
    return np.maximum(x, 0), ahead, right, down, below


def _best_weight(solve, weights, iterations, press, y, truth):
    """Least error over the weights, and with the exact H over those near the best."""
    state = solve(by_modes(press.blur), y, weights, iterations)
    errors = [nrmse(image, truth) for image in state[0]]
    if press.noise < EXACT_NOISE and truth.size <= EXACT_CELLS:
        best = int(np.argmin(errors))
        near = slice(max(best - 1, 0), best + 2)
        state = [each[near] for each in state]
        images = solve(by_matrix(press.blur), y, weights[near], EXACT_ITERATIONS, state)[0]
        errors += [nrmse(image, truth) for image in images]
    return min(errors)


def tuned(press):
    """NRMSE of each of PEERS at the setting that is best for this press."""
    peak = float(press.frame.max())
    y, truth = (press.frame / peak).astype(np.float32), press.truth / peak
    return {
        "W*": min(nrmse(skimage_wiener(press.psf, each, y.astype(float)), truth) for each in BALANCES),
        "RL*": min(nrmse(skimage_rl(press.psf, each, y.astype(float)), truth) for each in STOPS),
        "NNT*": _best_weight(tikhonov, TIKHONOV_WEIGHTS, TIKHONOV_ITERATIONS, press, y, truth),
        "TV*": _best_weight(total_variation, TV_WEIGHTS, TV_ITERATIONS, press, y, truth),
    }


def peer_errors(press, folder: Path | None = None):
    """The same, from `folder` if this press was tuned before."""
    if folder is None:
        return tuned(press)
    parts = press.frame, press.truth, press.psf
    key = sha256(b"".join([f"{VERSION} {press.noise}".encode(), *(each.tobytes() for each in parts)]))
    path = folder / f"{key.hexdigest()[:24]}.json"
    if path.exists():
        return json.loads(path.read_text())
    errors = tuned(press)
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{getpid()}")  # others may be reading
    part.write_text(json.dumps(errors))
    part.replace(path)
    return errors
