"""Speed against accuracy: every method timed and scored on the same frames, in one run on one thread."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from tactiled.restore.methods import METHODS, make
from tactiled.restore.richardson_lucy import Lucy
from tactiled.restore.scene import Scene
from tactiled.study.machine import describe
from tactiled.study.peers import STOPS, Restore, absent, ours, peers
from tactiled.study.restore import nrmse
from tactiled.study.skin import Film, Frames, Skin, films

Run = tuple[Restore, Callable[[], None]]  # a frame's restoration, and what forgets the frames so far

SHORT, LONG = 5, 200  # iterations of ours beside its own
SAME = 0.01  # of an error: images that differ by less are called the same
FLOOR = "best linear filter, told the truth's spectrum"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much to measure."""

    covers: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0)  # t/pitch
    noises: tuple[float, ...] = (0.002, 0.01, 0.05)  # of the frame's peak
    size: int = 32
    frames: int = 8  # of every scene's film
    rounds: int = 5  # over which the least median counts: others may be using the machine
    peers: int = 2  # rounds of the slow ones
    stops: tuple[int, ...] = STOPS


QUICK = Effort(covers=(1.0, 3.0), noises=(0.01, 0.05), frames=2, rounds=3, peers=1, stops=STOPS[:2])


@dataclass(frozen=True, slots=True)
class Mark:
    """What one method did in one panel."""

    method: str
    ours: bool
    nrmse: float  # mean over the scenes' films
    median: float  # microseconds a frame
    p99: float
    front: bool = False  # nothing else is both faster and more accurate


@dataclass(frozen=True, slots=True)
class Panel:
    """One cover and one noise."""

    skin: str
    thickness: float  # pitches
    noise: float  # of the frame's peak
    floor: float  # NRMSE of the best linear filter that knows the truth's own spectrum
    marks: tuple[Mark, ...]

    def mark(self, method: str) -> Mark:
        """What `method` did."""
        return next(mark for mark in self.marks if mark.method == method)


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the (cost, error) points that no other beats in both, cheapest first; of equals, the first."""
    order = sorted(range(len(points)), key=lambda n: (*points[n], n))
    found: list[int] = []
    for n in order:
        if not found or points[n][1] < points[found[-1]][1]:
            found.append(n)
    return found


def beaten(panel: Panel, method: str = "auto") -> list[Mark]:
    """The marks that are at least as fast and as accurate as `method`, and better in one of them."""
    mine = panel.mark(method)
    return [
        each
        for each in panel.marks
        if (each.median <= mine.median and each.nrmse <= mine.nrmse)
        and (each.median, each.nrmse) != (mine.median, mine.nrmse)
    ]


def best_peer(panel: Panel) -> Mark | None:
    """The most accurate mark that is none of ours."""
    return min((mark for mark in panel.marks if not mark.ours), key=lambda mark: mark.nrmse, default=None)


def rivals(panel: Panel) -> str:
    """What beats `auto` in a panel, and by how much."""
    mine = panel.mark("auto")
    said = (
        f"{each.method}, by {100 * (1 - each.nrmse / mine.nrmse):.1f} % of the error and"
        f" {100 * (1 - each.median / mine.median):.0f} % of the time"
        for each in beaten(panel)
    )
    return "; ".join(said) or "nothing"


def verdict(found: Sequence[Panel]) -> Iterator[str]:
    """Say where `auto` is on the Pareto front, where it is not, and why not."""
    lost = [one for one in found if beaten(one)]
    yield f"auto is on the Pareto front in {len(found) - len(lost)} of {len(found)} panels."
    for one in lost:
        mine = one.mark("auto")
        better = [each for each in beaten(one) if each.nrmse < (1 - SAME) * mine.nrmse]
        why = (
            "it chose another method, and not the best"
            if better
            else "it comes to the same image, and the time is what it takes to choose"
        )
        yield f"Not at {one.skin}, {100 * one.noise:g} % noise: {rivals(one)}. Why: {why}."


def panels(skins: Iterable[Skin], effort: Effort, seed: int) -> Iterator[Panel]:
    """Measure every skin at every noise."""
    for skin in skins:
        for noise in effort.noises:
            yield panel(skin, noise, effort, seed)


def panel(skin: Skin, noise: float, effort: Effort, seed: int) -> Panel:
    """Measure one skin at one noise."""
    errors: dict[str, list[float]] = {}
    times: dict[str, list[list[float]]] = {}
    floors = []
    for film in films(skin, noise, effort.frames, seed):
        floors.append(floor(skin, film))
        for name, (run, forget) in _runs(skin, film, noise, effort.stops).items():
            rounds = effort.rounds if ours(name) else effort.peers
            played = [_play(run, forget, film) for _ in range(rounds)]
            errors.setdefault(name, []).append(played[0][0])
            for all_, (_, took) in zip(times.setdefault(name, [[] for _ in range(rounds)]), played, strict=True):
                all_ += took
    marks = [Mark(name, ours(name), float(np.mean(errors[name])), *_least(times[name])) for name in errors]
    chosen = front([(mark.median, mark.nrmse) for mark in marks])
    told = tuple(Mark(**asdict(mark) | {"front": n in chosen}) for n, mark in enumerate(marks))
    return Panel(skin.name, skin.thickness, noise, float(np.mean(floors)), told)


def floor(skin: Skin, film: Film) -> float:
    """Expected NRMSE of the best filter mode by mode, told how much of the truth is in each mode.

    No linear filter in the blur's modes passes it in the mean; one that knows pressure never pulls may.
    """
    modes = skin.blur.modes
    left, right = modes.surface if len(modes.surface) == 2 else (modes.surface[0], None)
    x = left.T @ film.truths[0]
    power = np.square(x if right is None else x @ right)
    gain = np.zeros_like(power)
    gain[modes.head] = modes.gain
    left_over = power * film.sigma**2 / np.maximum(gain**2 * power + film.sigma**2, 1e-300)
    return float(np.sqrt(left_over.sum() / power.sum()))


def _least(rounds: list[list[float]]) -> tuple[float, float]:
    """The least median and the least 99th percentile of the rounds."""
    return min(float(np.median(each)) for each in rounds), min(float(np.percentile(each, 99)) for each in rounds)


def _play(run: Restore, forget: Callable[[], None], film: Film) -> tuple[float, list[float]]:
    """Restore a film from its start: mean NRMSE, and microseconds of each frame."""
    forget()
    errors, took = [], []
    for frame, truth in zip(film.frames, film.truths, strict=True):
        start = perf_counter()
        image = run(frame)
        took.append(1e6 * (perf_counter() - start))
        errors.append(nrmse(image, truth))
    return float(np.mean(errors)), took


def _runs(skin: Skin, film: Film, noise: float, stops: tuple[int, ...]) -> dict[str, Run]:
    runs = {name: _method(skin, film, name) for name in METHODS}
    for count in (SHORT, LONG):
        runs[f"rl {count}"] = _lucy(skin, film, count)
    if skin.psf is not None:
        theirs = peers(skin.psf, film.frames.shape[1:], noise, stops)
        runs |= {name: (run, lambda: None) for name, run in theirs.items()}
    return runs


def _method(skin: Skin, film: Film, name: str) -> Run:
    restorer = make(name, skin.blur, film.sigma)
    return lambda frame: restorer(frame).image, restorer.reset


def _lucy(skin: Skin, film: Film, iterations: int) -> Run:
    """Our Richardson-Lucy, stopped by the noise or after so many."""
    scene = Scene(skin.blur, film.sigma)
    lucy = Lucy(scene, iterations)

    def run(frame: Frames) -> Frames:
        scene.look(frame)
        lucy(frame)
        return lucy.image

    return run, lambda: None


def write(folder: Path, found: list[Panel], seed: int) -> None:
    """Put the marks into frontier.csv, and into frontier.json what `auto` is worth beside them."""
    with (folder / "frontier.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(("skin", "t/pitch", "noise", "method", "NRMSE", "median us", "p99 us", "on front"))
        for one in found:
            for mark in one.marks:
                figures = (f"{mark.nrmse:.6f}", f"{mark.median:.2f}", f"{mark.p99:.2f}", int(mark.front))
                rows.writerow((one.skin, f"{one.thickness:g}", one.noise, mark.method, *figures))
    text = json.dumps(summary(found, seed), indent=2)
    (folder / "frontier.json").write_text(text + "\n", encoding="utf-8")


def summary(found: list[Panel], seed: int) -> dict[str, Any]:
    """Everything measured, and in each panel what beats `auto` and by how much."""
    told = [
        asdict(one) | {"beats auto": {each.method: _by(each, one.mark("auto")) for each in beaten(one)}}
        for one in found
    ]
    machine = {"machine": describe(), "threads": 1, "peers not installed": absent()}
    return {"seed": seed} | machine | {"floor": FLOOR, "panels": told}


def _by(better: Mark, than: Mark) -> dict[str, float]:
    return {"times as fast": than.median / better.median, "error over its error": than.nrmse / better.nrmse}
