"""Times of single frames: cold, after a jump, and while a scene moves."""

from collections import defaultdict
from functools import partial
from itertools import cycle, product
from math import inf
from time import thread_time

import numpy as np
from rich.progress import track

from tactiled.bench.results import machine
from tactiled.bench.scenes import PEAK_KPA
from tactiled.bench.skin import rubber, sense
from tactiled.cli.bench import print_table
from tactiled.live.budget import Deadline
from tactiled.restore.methods import make
from tests.bench.held_out_scenes import HELD_OUT_SCENES, MOTIONS, held_out
from tests.bench.judge import NOISES, THICKNESSES

PASSES = 3  # through the same frames, of whose times the least counts: others empty the caches
CLIP_FRAMES, MAX_RUN = 12, 8  # frames of a clip, and at most of it before the next jump
ROUNDS = 28  # of a pass through every setting: each makes restorers anew, which takes longer than many frames
SLOWEST, AGAIN = 20, 20  # so many of a pass' slowest frames are timed so often again: others may have slowed them
COLD = 2  # frames of a pass on a fresh, prepared restorer
IDLE = 0.05  # of the runs: nothing touches
SPOTS = ("bumps", "caps")  # of which fits of points may fail
HEADINGS = ("", "frames", "median", "p99", "p99.9", "worst")


def clean_clips(size, thickness, seed):
    """Kinds and their noiseless frames (CLIP_FRAMES, R, C) at a peak of PEAK_KPA, one in each motion in turn."""
    skin = rubber(thickness, size)
    for scene, motion in zip(HELD_OUT_SCENES, cycle(MOTIONS)):
        frames = [sense(skin, held_out(scene, skin, seed, motion, n))[0] for n in range(CLIP_FRAMES)]
        yield scene, PEAK_KPA * np.stack(frames) / np.max(frames)


def chunk(clips, count, noise, random):
    """Labels and frames (count, R, C): runs of clips at any place, load and symmetry of the square."""
    labels, frames = [], []
    while len(frames) < count:
        scene, clip = clips[random.integers(len(clips))]
        first, run = random.integers(0, CLIP_FRAMES - 1), random.integers(1, MAX_RUN + 1)
        turned = np.rot90(clip[first : first + run], random.integers(4), (1, 2))[:, :: random.choice([-1, 1])]
        load, label = random.uniform(0.2, 1), "jump to spots" if scene in SPOTS else "jump"
        if random.random() < IDLE:
            load, label = 0.0, "idle"
        labels += [label, *["idle" if label == "idle" else "warm"] * (len(turned) - 1)]
        frames.extend(load * turned)
    noisy = np.array(frames[:count]) + random.normal(0, noise * PEAK_KPA, (count, *clips[0][1].shape[1:]))
    return labels[:count], noisy.astype(np.float32)


def timed(run, frame):
    """Microseconds of this thread's processor time for one frame: others may be using the machine."""
    start = thread_time()
    run(frame)
    return 1e6 * (thread_time() - start)


def prepared(method, skin, noise, budget_s):
    """A fresh restorer, with all made that can be before its first frame; each image ends after a budget."""
    restorer = make(method, skin.blur, noise * PEAK_KPA)
    restorer.prepare()
    return lambda frame: restorer(frame, None, Deadline(budget_s))


def shortest_times(restorers, fresh, frames):
    """Label and least microseconds of every frame: of those with labels, and of cold ones."""
    tasks = [("cold", frame) for _, frame in frames[:COLD]] + frames

    def once(at, restorer):
        label, frame = tasks[at]
        return timed(fresh() if label == "cold" else restorer, frame)

    shortest = np.min([[once(at, each) for at in range(len(tasks))] for each in restorers], axis=0)
    for at in np.argsort(shortest)[-SLOWEST:]:
        for _ in range(AGAIN):
            restorers[0](tasks[at - 1][1])
            shortest[at] = min(shortest[at], once(at, restorers[0]))
    return [(label, took) for (label, _), took in zip(tasks, shortest, strict=True)]


def measure(size, frames, seed, method="auto", budget_s=inf):
    """Microseconds (frames,) by label, the least of PASSES each or more."""
    random, times, settings = np.random.default_rng(seed), defaultdict(list), []
    for thickness in THICKNESSES:
        skin, clips = rubber(thickness, size), list(clean_clips(size, thickness, seed))
        settings += [
            (skin, clips, n, [prepared(method, skin, n, budget_s) for _ in range(PASSES)]) for n in NOISES
        ]
    count = -(-frames // (ROUNDS * len(settings)))
    for _, (skin, clips, noise, restorers) in track(
        list(product(range(ROUNDS), settings)), f"{size}", transient=True
    ):
        labels, sequence = chunk(clips, count, noise, random)
        fresh = partial(prepared, method, skin, noise, budget_s)
        for label, took in shortest_times(restorers, fresh, list(zip(labels, sequence, strict=True))):
            times[label].append(took)
    return {label: np.array(took) for label, took in times.items()}


def frame_times(
    frames: int = 20_000, sizes: str = "16,32,64", method: str = "auto", seed: int = 1, budget_ms: float = inf
) -> None:
    """Time very many single frames of mixed scenes."""
    for size in map(int, sizes.split(",")):
        times = measure(size, frames, seed, method, 1e-3 * budget_ms)
        rows = []
        for label, took in {**times, "all": np.concatenate(list(times.values()))}.items():
            figures = np.percentile(took, (50, 99, 99.9, 100))
            rows.append((label, str(len(took)), *(f"{each:.0f}" for each in figures)))
        print_table(f"{method} at {size} x {size}: µs a frame, the least of {PASSES} passes", HEADINGS, rows)
    print(machine())
