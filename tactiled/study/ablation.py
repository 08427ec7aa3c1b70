"""What each rule of `auto` earns: films restored with all rules, and with one of them off."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from time import thread_time

import numpy as np

from tactiled.restore.auto import REVIEW, Auto
from tactiled.restore.modes import Image
from tactiled.restore.scene import Restored, Scene
from tactiled.restore.wiener import Filter
from tactiled.study.restore import nrmse
from tactiled.study.skin import Film, Frames, Skin, films

ROUNDS = 3  # over which the least time of a frame counts
REST = 2  # idle frames before every scene
FAINTEST = 0.4  # of a scene, to which one that rises from nothing comes: where rules give way to one another


class _NoIdle(Auto):
    def rests(self, y: Image) -> bool:
        del y
        return False


class _NoRaw(Auto):
    def _untouched(self, chosen: Filter) -> str:
        del chosen
        return ""


class _NoLinear(Auto):
    def _linear(self, image: Image) -> bool:
        del image
        return False


class _NoPoints(Auto):
    def _pointed(self, y: Image) -> int:
        del y
        return 0


class _NoPause(Auto):
    def _pointed(self, y: Image) -> int:
        self._wait = 0
        return super()._pointed(y)


class _NoStay(Auto):
    def _reach(self, method: str) -> float:
        del method
        return 1.0


class _NoReview(Auto):
    def _some(self, y: Image) -> Restored:
        self._age = REVIEW
        return super()._some(y)


class _NoWarm(Auto):
    def _iterated(self, y: Image) -> Restored:
        self._nonneg.reset()
        return super()._iterated(y)


class _NoGoingOn(Auto):
    def _pointed(self, y: Image) -> int:
        self.points.reset()
        return super()._pointed(y)


RULES: dict[str, tuple[str, type[Auto]]] = {
    "idle": ("a frame of noise is left empty", _NoIdle),
    "raw": ("a cover that hardly matters is left alone", _NoRaw),
    "wiener": ("a linear image that hardly falls below zero is kept", _NoLinear),
    "points": ("a few points are fitted where they explain the frame", _NoPoints),
    "pause": ("points are left alone for a while after a fit that did not stand", _NoPause),
    "stay": ("the method of the frame before is kept on the border", _NoStay),
    "review": ("linear is asked for again at every eighth frame only", _NoReview),
    "warm start": ("iterations go on from the image before", _NoWarm),
    "warm points": ("points go on from those before", _NoGoingOn),
}


@dataclass(frozen=True, slots=True)
class Earned:
    """One rule: all frames as they are, and without it."""

    rule: str
    frames: int  # that come out otherwise without it
    of: int
    time: float  # microseconds a frame, mean
    time_without: float
    median: float  # of the same
    median_without: float
    error: float  # NRMSE of the pressed frames, mean
    error_without: float
    worse: float  # the error without it over the error with it, on the pressed frames that come out otherwise
    changes: int  # of the method from one frame to the next
    changes_without: int


@dataclass(slots=True)
class _Played:
    """One film through one `auto`."""

    images: list[Frames]
    methods: list[str]
    times: list[float]  # microseconds of the thread's own clock, the least of the rounds
    errors: list[float]  # NaN where nothing was pressed


def measure(skins: list[Skin], noises: tuple[float, ...], frames: int, seed: int) -> list[Earned]:
    """Play films, each of a scene that moves after a rest, to `auto` with every rule off in turn."""
    found: dict[str, list[_Played]] = {name: [] for name in ("auto", *RULES)}
    for film, skin in _films(skins, noises, frames, seed):
        for name, played in found.items():
            played.append(_play(skin, film, RULES[name][1] if name in RULES else Auto))
    return [_earned(rule, found["auto"], found[rule]) for rule in RULES]


def _earned(rule: str, with_: list[_Played], without: list[_Played]) -> Earned:
    pairs = [pair for a, b in zip(with_, without, strict=True) for pair in zip(a.images, b.images, strict=True)]
    other = np.array([not np.allclose(a, b, rtol=1e-3, atol=1e-3 * float(np.abs(a).max())) for a, b in pairs])
    times = [np.array([time for each in played for time in each.times]) for played in (with_, without)]
    errors = [np.array([error for each in played for error in each.errors]) for played in (with_, without)]
    there = other & np.isfinite(errors[0])
    changes = [sum(a != b for each in played for a, b in pairwise(each.methods)) for played in (with_, without)]
    return Earned(
        rule=rule,
        frames=int(other.sum()),
        of=other.size,
        time=float(times[0].mean()),
        time_without=float(times[1].mean()),
        median=float(np.median(times[0])),
        median_without=float(np.median(times[1])),
        error=float(np.nanmean(errors[0])),
        error_without=float(np.nanmean(errors[1])),
        worse=float(errors[1][there].mean() / errors[0][there].mean()) if there.any() else 1.0,
        changes=changes[0],
        changes_without=changes[1],
    )


def _films(skins: list[Skin], noises: tuple[float, ...], frames: int, seed: int) -> Iterator[tuple[Film, Skin]]:
    for skin in skins:
        for noise in noises:
            for film in films(skin, noise, frames, seed):
                random = np.random.default_rng([seed, 9])
                idle = random.normal(0, film.sigma, (REST, *skin.array.frame_shape)).astype(np.float32)
                moving = np.concatenate([idle, film.frames])
                yield Film(film.scene, film.sigma, moving, np.concatenate([0 * idle, film.truths])), skin
            yield _rising(next(films(skin, noise, 1, seed, ("blobs",))), frames, seed), skin


def _rising(still: Film, frames: int, seed: int) -> Film:
    """A scene that rises from nothing, slowly, under the same noise."""
    ramp = np.linspace(0, FAINTEST, frames + REST).reshape(-1, *[1] * (still.frames.ndim - 1))
    white = np.random.default_rng([seed, 10]).normal(0, still.sigma, (len(ramp), *still.frames.shape[1:]))
    return Film("rising", still.sigma, (ramp * still.frames + white).astype(np.float32), ramp * still.truths)


def _play(skin: Skin, film: Film, kind: type[Auto]) -> _Played:
    scene = Scene(skin.blur, film.sigma)
    auto = kind(scene)
    least = np.full(len(film.frames), np.inf)
    for _ in range(ROUNDS):
        auto.reset()
        images, methods, errors = [], [], []
        for n, (frame, truth) in enumerate(zip(film.frames, film.truths, strict=True)):
            start = thread_time()
            scene.high, scene.low = frame.item(frame.argmax()), frame.item(frame.argmin())
            done = auto(frame)
            least[n] = min(least[n], 1e6 * (thread_time() - start))
            images.append(done.image.copy())
            methods.append(done.method)
            errors.append(nrmse(done.image, truth) if truth.any() else np.nan)
    return _Played(images, methods, least.tolist(), errors)
