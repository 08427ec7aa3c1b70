"""A frame after others: its error over that of the same frame alone."""

from functools import partial
from itertools import chain, islice, permutations, product
from typing import NamedTuple

import numpy as np
from rich.progress import track

from tactiled.cli.bench import Reduced, print_table
from tactiled.restore.methods import make
from tactiled.study.scenes import PEAK_KPA
from tactiled.study.skin import nrmse, rubber, sense
from tests.study.held_out_scenes import APPEARS, FINER, HELD_OUT_SCENES, MOTIONS, growing_bump, held_out
from tests.study.judge import NOISES, THICKNESSES, WORSE

FRAMES = 8  # that a scene is held, and that are judged after another
MOVING_FRAMES, JUMPS, WORST = 20, 200, 10  # of a clip, at random, and printed
RATIOS = 1.1, 1.3  # of the error to that of the frame alone: what is counted
HEADINGS = ("", "frames", "mean", "worst", *(f"> {each}" for each in RATIOS), "> 2 % over raw", "alone")


class Step(NamedTuple):
    """NRMSE of one frame after others, of the same frame alone, and of its raw image."""

    case: str
    error: float
    alone: float
    raw: float


def recorded(skin, pressures, noise, random):
    """Frames and truths of pressures on fine cells, scaled to a peak of PEAK_KPA; noise is relative to that."""
    clean, truths = (np.stack(each) for each in zip(*(sense(skin, each) for each in pressures), strict=True))
    scale, white = PEAK_KPA / clean.max(), random.normal(0, noise * PEAK_KPA, clean.shape)
    return (scale * clean + white).astype(np.float32), scale * truths


def play(fresh, frames, truths, before=()):
    """Error of every frame by a fresh restorer, after the frames `before`."""
    restorer = fresh()
    for frame in before:
        restorer(frame)
    return [nrmse(restorer(frame).image, truth) for frame, truth in zip(frames, truths, strict=True)]


def alone(fresh, frames, truths):
    """Error of every frame alone, and of its raw image."""
    pairs = list(zip(frames, truths, strict=True))
    return [(play(fresh, [frame], [truth])[0], nrmse(frame, truth)) for frame, truth in pairs]


def steps(method, skin, noise, seed):
    """Every frame judged: (group, Step)."""
    random, about = (
        np.random.default_rng([seed, int(1e4 * noise)]),
        f"t/pitch {skin.thickness:g}, {100 * noise:g} %",
    )
    fresh = partial(make, method, skin.blur, noise * PEAK_KPA)
    still = {scene: [held_out(scene, skin, seed)] * FRAMES for scene in HELD_OUT_SCENES}
    still["growing"] = [growing_bump(skin, seed, n) for n in range(FRAMES)]
    clips = {scene: recorded(skin, each, noise, random) for scene, each in still.items()}
    single = {scene: alone(fresh, *clip) for scene, clip in clips.items()}
    for a, b in permutations(clips, 2):
        for n, error in enumerate(play(fresh, *clips[b], clips[a][0])):
            yield f"frame {n + 1}", Step(f"{a}, then {b}, {about}", error, *single[b][n])
    places = list(zip(random.choice(list(clips), JUMPS), random.integers(0, FRAMES, JUMPS), strict=True))
    frames, truths = zip(*((clips[scene][0][n], clips[scene][1][n]) for scene, n in places), strict=True)
    for error, (scene, n) in zip(play(fresh, frames, truths), places, strict=True):
        yield "jumps", Step(f"jump to {scene}, {about}", error, *single[scene][n])
    for motion, scene in product(MOTIONS[1:], HELD_OUT_SCENES):
        pressures = [held_out(scene, skin, seed, motion, n) for n in range(MOVING_FRAMES)]
        frames, truths = recorded(skin, pressures, noise, random)
        first = APPEARS if motion == "appearing" else 0
        errors = play(fresh, frames[first:], truths[first:], frames[:first])
        for error, others in zip(errors, alone(fresh, frames[first:], truths[first:]), strict=True):
            yield motion, Step(f"{motion} {scene}, {about}", error, *others)


def summary(group, judged):
    """One line by HEADINGS."""
    error, alone, raw = np.array([each[1:] for each in judged]).T
    counts = (
        *((error / alone > each).sum() for each in RATIOS),
        (error > WORSE * raw).sum(),
        (alone > WORSE * raw).sum(),
    )
    ratios = f"{np.mean(error / alone):.3f}", f"{np.max(error / alone):.2f}"
    return group, str(len(judged)), *ratios, *map(str, counts)


def transitions(reduced: Reduced = False, method: str = "auto", size: int = 32, seed: int = 1) -> None:
    """Let every scene of the second family follow every other, jump and move; compare with each frame alone."""
    groups: dict[str, list[Step]] = {}
    for thickness, noise in track(list(product((1.0, 3.0) if reduced else THICKNESSES, NOISES)), transient=True):
        for group, step in steps(method, rubber(thickness, size, FINER), noise, seed):
            groups.setdefault(group, []).append(step)
    pairs = list(chain(*(judged for group, judged in groups.items() if group.startswith("frame"))))
    rows = [summary(group, judged) for group, judged in (groups | {"all pairs": pairs}).items()]
    print_table(f"Error of {method} over that of the frame alone, {size} x {size}", HEADINGS, rows)
    worst: dict[str, Step] = {}
    higher = (each for each in chain(*groups.values()) if each.error > RATIOS[0] * each.alone)
    for each in sorted(higher, key=lambda each: each.alone / each.error):
        worst.setdefault(each.case, each)
    for case, error, alone, raw in islice(worst.values(), WORST):
        print(f"{error / alone:5.2f}: {case}: {error:.3f}, alone {alone:.3f}, raw {raw:.3f}")
