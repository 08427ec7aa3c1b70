"""How often the service would warn of a frame with nothing wrong."""

from collections import Counter

import numpy as np

from tactiled.cli.bench import print_lines
from tactiled.diagnostics.checks import FrameChecks
from tactiled.restore.methods import make
from tactiled.study.results import machine
from tactiled.study.skin import clips, rubber

COVERS = (0.5, 1.0, 2.0, 3.0)  # t/pitch
NOISES = (0.002, 0.01, 0.05)  # of the peak


def measure(covers, size, noises, places, seed):
    """Frames, and how often each warning came at a first look: every scene at so many places, restored by auto."""
    warnings, frames = Counter(), 0
    for skin in (rubber(thickness, size) for thickness in covers):
        checks = FrameChecks(skin.blur)
        for noise in noises:
            for clip in (clip for place in range(places) for clip in clips(skin, noise, 1, seed + place)):
                frame = clip.frames[0]
                done = make("auto", skin.blur, clip.sigma)(frame)
                unflagged = np.zeros(frame.shape, np.uint8)
                warnings.update(checks.check(frame, unflagged, done.image, clip.sigma, done.method))
                frames += 1
    return frames, warnings


def false_warnings(places: int = 120, size: int = 32, seed: int = 1) -> None:
    """Count warnings on frames with nothing wrong."""
    frames, warnings = measure(COVERS, size, NOISES, places, seed)
    print_lines(f"{frames} frames, {warnings.total()} warnings at a first look.")
    print_lines(*(f"{count} x {code}" for code, count in warnings.items()), machine())
