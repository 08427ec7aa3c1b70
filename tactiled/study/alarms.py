"""How often the service would warn of a frame with nothing wrong."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tactiled.diagnostics.checks import FrameChecks
from tactiled.restore.methods import make
from tactiled.study.skin import Skin, films


@dataclass(frozen=True, slots=True)
class Alarms:
    """What was said of sound frames at a first look."""

    frames: int
    wrong: int  # frames that any warning came with
    said: dict[str, int]  # how often each


def measure(skins: Iterable[Skin], noises: tuple[float, ...], places: int, seed: int) -> Alarms:
    """Restore every scene at so many places, with noise of its own each time, by auto from cold, and look."""
    said: Counter[str] = Counter()
    frames = wrong = 0
    for skin in skins:
        checks = FrameChecks(skin.blur)
        for noise in noises:
            for place in range(places):
                for film in films(skin, noise, 1, seed + place):
                    frame = film.frames[0]
                    done = make("auto", skin.blur, film.sigma)(frame)
                    found = checks.check(
                        frame, np.zeros(frame.shape, np.uint8), done.image, film.sigma, done.method
                    )
                    frames += 1
                    wrong += bool(found)
                    said.update(found)
    return Alarms(frames, wrong, dict(said))
