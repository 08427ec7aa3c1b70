"""What each rule of `auto` contributes: clips restored with all rules, and with one of them off."""

from itertools import chain, pairwise
from time import thread_time
from typing import NamedTuple

import numpy as np

from tactiled.cli.bench import print_lines, print_table
from tactiled.restore.auto import REVIEW_FRAMES, Auto
from tactiled.restore.scene import Scene
from tactiled.study.results import machine
from tactiled.study.skin import Clip, clips, nrmse, rubber

COVERS = (0.1, 0.5, 1.0, 2.0, 3.0)  # t/pitch
NOISES = (0.01, 0.05)  # of the peak
ROUNDS = 3  # over which the least time of a frame counts
IDLE_FRAMES = 2  # before every scene
FAINTEST = 0.4  # of a scene, to which one that rises from zero comes: where rules give way to one another


def _always(value):
    return lambda *_: value


def _before(change, name):
    """The method `name` of `Auto`, after `change` of the instance."""

    def instead(self, y):
        change(self)
        return getattr(Auto, name)(self, y)

    return instead


# rule -> what it does, the method of `Auto` that decides it, that method without the rule
RULES = {
    "idle": ("a frame of noise is empty", "is_idle", _always(False)),
    "raw": ("a cover that hardly matters is not restored", "_raw_reason", _always("")),
    "wiener": ("a linear image that hardly falls below zero stays linear", "_linear", _always(False)),
    "points": ("a few points are fitted where they explain the frame", "_point_steps", _always(0)),
    "pause": ("no fit of points soon after one that failed", "_point_steps",
              _before(lambda auto: setattr(auto, "_wait", 0), "_point_steps")),
    "hysteresis": ("the method of the previous frame stays on the border", "_reach", _always(1.0)),
    "review": ("linear is tested again at every eighth frame only", "_restored",
               _before(lambda auto: setattr(auto, "_age", REVIEW_FRAMES), "_restored")),
    "warm start": ("iterations start from the previous image", "_iterated",
                   _before(lambda auto: auto._nonnegative.reset(), "_iterated")),
    "warm points": ("points start from the previous points", "_point_steps",
                    _before(lambda auto: auto.points.reset(), "_point_steps")),
}  # fmt: skip
HEADINGS = ("without", "frames changed", "mean µs", "median µs", "error", "of these, times", "changes of method")


class Result(NamedTuple):
    """All clips with one rule off."""

    changed: int  # frames that differ from those with all rules
    mean_us: float
    median_us: float
    error: float  # NRMSE of the pressed frames, mean
    worse: float  # error over that with all rules, on the pressed frames that differ
    switches: int  # of the method from one frame to the next


def measure(covers, size, noises, frames, seed):
    """Results by rule that is off, and with all rules by "none"."""
    kinds = {"none": Auto}
    kinds |= {rule: type(rule, (Auto,), {method: off}) for rule, (_, method, off) in RULES.items()}
    played = {name: [] for name in kinds}
    for skin in (rubber(thickness, size) for thickness in covers):
        for clip in (clip for noise in noises for clip in moving(skin, noise, frames, seed)):
            for name, kind in kinds.items():
                played[name].append(play(skin, clip, kind))
    return {name: _result(played["none"], each) for name, each in played.items()}


def _result(with_all, without):
    images, methods, times, errors = zip(*without, strict=True)
    before, _, _, errors_before = zip(*with_all, strict=True)
    pairs = zip(chain(*before), chain(*images), strict=True)
    differs = np.array([not np.allclose(a, b, rtol=1e-3, atol=1e-3 * float(np.abs(a).max())) for a, b in pairs])
    times, errors, errors_before = (np.concatenate(each) for each in (times, errors, errors_before))
    both = differs & np.isfinite(errors)
    worse = float(errors[both].mean() / errors_before[both].mean()) if both.any() else 1.0
    switches = sum(a != b for each in methods for a, b in pairwise(each))
    return Result(int(differs.sum()), times.mean(), float(np.median(times)), np.nanmean(errors), worse, switches)


def moving(skin, noise, frames, seed):
    """Every scene, moving after a rest; and one that slowly rises from zero."""
    for clip in clips(skin, noise, frames, seed):
        random = np.random.default_rng([seed, 9])
        idle = random.normal(0, clip.sigma, (IDLE_FRAMES, *skin.array.frame_shape)).astype(np.float32)
        truths = np.concatenate([0 * idle, clip.truths])
        yield Clip(clip.scene, clip.sigma, np.concatenate([idle, clip.frames]), truths)
    still = next(clips(skin, noise, 1, seed, ("blobs",)))
    ramp = np.linspace(0, FAINTEST, frames + IDLE_FRAMES).reshape(-1, 1, 1)
    white = np.random.default_rng([seed, 10]).normal(0, still.sigma, (len(ramp), *skin.array.frame_shape))
    yield Clip("rising", still.sigma, (ramp * still.frames + white).astype(np.float32), ramp * still.truths)


def play(skin, clip, kind):
    """Images, methods, microseconds by the thread's clock, and errors (NaN where nothing is pressed)."""
    scene = Scene(skin.blur, clip.sigma)
    auto = kind(scene)
    times = np.full(len(clip.frames), np.inf)
    for _ in range(ROUNDS):
        auto.reset()
        images, methods, errors = [], [], []
        for n, (frame, truth) in enumerate(zip(clip.frames, clip.truths, strict=True)):
            start = thread_time()
            scene.high, scene.low = frame.item(frame.argmax()), frame.item(frame.argmin())
            done = auto(frame)
            times[n] = min(times[n], 1e6 * (thread_time() - start))
            images.append(done.image.copy())
            methods.append(done.method)
            errors.append(nrmse(done.image, truth) if truth.any() else np.nan)
    return images, methods, times, errors


def ablation(frames: int = 40, size: int = 32, seed: int = 1) -> None:
    """Restore moving clips by auto with all of its rules, and with one of them off."""
    rows = [
        (name, str(each.changed), f"{each.mean_us:.1f}", f"{each.median_us:.1f}", f"{each.error:.4f}",
         f"{each.worse:.2f}", str(each.switches))
        for name, each in measure(COVERS, size, NOISES, frames, seed).items()
    ]  # fmt: skip
    print_table("Rules of auto, one off at a time", HEADINGS, rows)
    print_lines(*(f"{rule}: {words}." for rule, (words, *_) in RULES.items()), machine())
