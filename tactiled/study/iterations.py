"""What many iterations of Richardson-Lucy do to noise, stopped by it and not."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.restore import solvers
from tactiled.restore.richardson_lucy import OFFSET, Lucy
from tactiled.restore.scene import Scene
from tactiled.study.charts import COLOURS, figure
from tactiled.study.faults import Case, Setting, white
from tactiled.study.restore import nrmse, richardson_lucy
from tactiled.study.skin import Frames

COUNTS = (1, 3, 10, 30, 100, 300, 1000, 3000, 10_000)
LABELS = {
    "rl": "rl: stopped by the noise",
    "rl-fast": "rl-fast: stopped by the noise",
    "unstopped": "rl, not stopped",
    "skimage rl": "scikit-image richardson_lucy",
}
LOOKS = ((COLOURS[1], "-"), (COLOURS[5], "-"), (COLOURS[1], (0, (5, 2))), (COLOURS[4], (0, (2, 2))))


@dataclass(frozen=True, slots=True)
class Count:
    """Mean error over the raw image's after so many iterations at one noise."""

    noise: float  # % of the peak
    method: str
    iterations: int
    over_raw: float


def measure(setting: Setting, most: int, noises: tuple[float, ...] = (1.0, 5.0)) -> list[Count]:
    """Iterate up to `most` times on every scene."""
    counts = [count for count in COUNTS if count <= most]
    found = []
    for noise in noises:
        told: dict[tuple[str, int], list[float]] = {}
        for case in white(noise, setting):
            raw = nrmse(case.frame, case.truth)
            for method, count, image in _images(case, counts):
                told.setdefault((method, count), []).append(nrmse(image, case.truth) / raw)
        found += [Count(noise, *key, float(np.mean(values))) for key, values in told.items()]
    return found


def _images(case: Case, counts: list[int]) -> list[tuple[str, int, Frames]]:
    blur, peak = case.skin.blur, float(case.frame.max())
    psf = np.asarray(case.skin.psf, np.float32)
    lift = np.float32(OFFSET * case.noise)
    lifted = np.maximum(case.frame + lift, np.float32(1e-3) * lift)
    free = np.full(blur.surface_shape, lifted.mean(), np.float32)
    weight = np.asarray(1 / np.maximum(blur.reach, 1e-3), np.float32)
    found, done = [], 0
    for count in counts:
        solvers.richardson_lucy(lambda x: blur.forward(x) + lift, blur.adjoint, lifted, free, weight, count - done)
        done = count
        found.append(("unstopped", count, free.copy()))
        for name, fast in (("rl", False), ("rl-fast", True)):
            scene = Scene(blur, case.noise)
            lucy = Lucy(scene, count, fast)
            scene.look(case.frame)
            lucy(case.frame)
            found.append((name, count, lucy.image.copy()))
        theirs = richardson_lucy(np.maximum(case.frame, 0), psf, count, clip=False, filter_epsilon=1e-6 * peak)
        found.append(("skimage rl", count, theirs))
    return found


def draw(path: Path, found: list[Count]) -> None:
    """Draw error against iterations, a panel for each noise."""
    noises = list(dict.fromkeys(one.noise for one in found))
    with figure(path, 10, 3.6) as drawn:
        for axes, noise in zip(drawn.subplots(1, len(noises), sharey=True, squeeze=False)[0], noises, strict=True):
            axes.axhspan(1, 2.1, color="#FBEEE6", lw=0, zorder=0)
            for (method, label), (colour, dashes) in zip(LABELS.items(), LOOKS, strict=True):
                same = [one for one in found if (one.noise, one.method) == (noise, method)]
                values = [min(one.over_raw, 2.0) for one in same]
                axes.plot([one.iterations for one in same], values, "o", ls=dashes, color=colour, label=label)
            axes.set(xscale="log", xlabel="iterations", title=f"Noise {noise:g} % of the peak", ylim=(0, 2.1))
        drawn.axes[0].set_ylabel("error over the raw image's")
        drawn.legend(*drawn.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
