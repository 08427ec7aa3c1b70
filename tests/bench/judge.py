"""Errors side by side with the best that other methods reach when they are tuned with the truth."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Annotated, Literal, NamedTuple

import numpy as np
import typer
from rich.progress import track

from tactiled.bench.skin import nrmse
from tactiled.cli.bench import print_table
from tactiled.restore.methods import make
from tests.bench.presses import FAMILIES, Press, presses
from tests.bench.tuned_peers import PEERS, peer_errors

THICKNESSES, NOISES = (0.5, 1.0, 2.0, 3.0), (0.002, 0.01, 0.05)
PRESSED = 0.02  # of the peak: cells with more count for the deviation
WORSE = 1.02  # times the raw image's error: more is a failure
RATIOS = 1.1, 1.5  # of a method's error to the best peer's in a cell: what is counted
HEADINGS = ("", "mean", "ratio", *(f"> {each}" for each in RATIOS), "worst", "where", "> 2 % over raw")

Method = Callable[[Press], object]  # gives the image, kPa
Cell = tuple[str, float, float]  # scene, t/pitch, noise


class Result(NamedTuple):
    """One press: NRMSE of the raw image, of each method, and of each tuned peer."""

    cell: Cell
    errors: dict[str, float]


def own(name: str) -> Method:
    """A method of METHODS, by a fresh restorer."""
    return lambda press: make(name, press.blur, press.sigma)(press.frame).image


def score(cases: Iterable[Press], methods: dict[str, Method], cache: Path | None = None) -> list[Result]:
    """Judge methods by name, each press alone; tuned peers are looked up in the folder `cache`."""
    results = []
    for press in cases:
        errors = {"raw": nrmse(press.frame, press.truth)}
        errors |= {name: nrmse(method(press), press.truth) for name, method in methods.items()}
        errors |= peer_errors(press, cache)
        results.append(Result((press.scene, press.thickness, press.noise), errors))
    return results


def cell_means(results: list[Result]) -> dict[Cell, dict[str, float]]:
    """Mean error by cell and name; "best" is the least of the peers' means."""
    means = {}
    for cell in dict.fromkeys(each.cell for each in results):
        errors = [each.errors for each in results if each.cell == cell]
        mean = {name: fmean(each[name] for each in errors) for name in errors[0]}
        means[cell] = mean | {"best": min(mean[name] for name in PEERS)}
    return means


class Verdict(NamedTuple):
    """One method against the best peer of every cell, and against the raw image of every press."""

    mean: float  # NRMSE over all presses
    ratios: dict[Cell, float]  # to the best peer
    over_raw: list[float]  # ratio of every press


def verdict(results: list[Result], name: str) -> Verdict:
    """Sum up one method or peer."""
    return Verdict(
        fmean(each.errors[name] for each in results),
        {cell: mean[name] / mean["best"] for cell, mean in cell_means(results).items()},
        [each.errors[name] / each.errors["raw"] for each in results],
    )


def summary(results: list[Result], name: str) -> tuple[str, ...]:
    """One line by HEADINGS of a method or peer."""
    mean, ratios, over_raw = verdict(results, name)
    scene, thickness, noise = worst = max(ratios, key=ratios.__getitem__)
    counts = (sum(each > ratio for each in ratios.values()) for ratio in RATIOS)
    figures = f"{mean:.4f}", f"{fmean(ratios.values()):.3f}", *map(str, counts), f"{ratios[worst]:.2f}"
    worse = f"{sum(each > WORSE for each in over_raw)}, at worst {max(over_raw):.2f}"
    return name, *figures, f"{scene}, {thickness:g}, {100 * noise:g} %", worse


def show(results: list[Result], methods: Iterable[str]) -> None:
    """Print the table of cells, then a line for each method and peer."""
    names = ["raw", *methods, *PEERS]
    means, ratios = cell_means(results), verdict(results, names[1]).ratios
    print("NRMSE.", "; ".join(f"{name}: {what}, tuned with the truth" for name, what in PEERS.items()))
    print(f"{'scene':10}  t/p    %", *(f"{name:>7}" for name in names), f"{names[1]} / best")
    for (scene, thickness, noise), mean in means.items():
        ratio = ratios[scene, thickness, noise]
        mark = " " + "!" * sum(ratio > each for each in RATIOS)
        errors = (f"{mean[name]:7.3f}" for name in names)
        print(f"{scene:10} {thickness:4g} {100 * noise:4g}", *errors, f"{ratio:5.2f}{mark}".rstrip())
    title = f"{len(results)} presses; ratio: error over the least of the four, {len(ratios)} cells"
    print_table(title, HEADINGS, [summary(results, name) for name in names])
    best = fmean(min(each.errors[name] for name in PEERS) for each in results)
    print(f"Least of the four, selected for every press: {best:.4f}")


def within(cases: Iterable[Press], name: str) -> dict[str, float]:
    """Share of the pressed cells, of each kind of scene, whose truth is within two deviations of the image."""
    shares: dict[str, list[float]] = {}
    for press in cases:
        restorer = make(name, press.blur, press.sigma)
        image = restorer(press.frame).image
        near = np.abs(image - press.truth) <= 2 * restorer.deviation()
        shares.setdefault(press.scene, []).append(near[press.truth > PRESSED * press.truth.max()].mean())
    return {scene: fmean(each) for scene, each in shares.items()}


def judge(
    family: Annotated[Literal["first", "second"], typer.Option(help="Of scenes; no constant knows 2.")] = "second",
    size: Annotated[int, typer.Option(help="Taxels along each side.")] = 32,
    repeats: Annotated[int, typer.Option(help="Presses of each scene, t/pitch and noise.")] = 2,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    methods: Annotated[str, typer.Option(help="Of ours, by commas: auto,nnls,...")] = "auto",
    scenes: Annotated[str, typer.Option(help="Only these kinds, by commas.")] = "",
    cache: Annotated[Path | None, typer.Option(help="Folder that keeps the errors of tuned peers.")] = None,
) -> None:  # fmt: skip
    """Compare errors with those of scikit-image's wiener and richardson_lucy, non-negative Tikhonov and TV.

    The four are tuned with the truth for every press, which takes a second each: use --cache.

    Ratio: error of the first method over the least of the four, each the mean of its cell (scene, t/pitch, noise).

    From Python: score() takes any function that gives the image (kPa) of a tests.bench.presses.Press.
    """
    kinds = tuple(filter(None, scenes.split(","))) or FAMILIES[family]
    cases = presses(size, THICKNESSES, NOISES, repeats, seed, kinds)
    total = len(kinds) * len(THICKNESSES) * len(NOISES) * repeats
    named = {name: own(name) for name in methods.split(",")}
    scored = partial(score, track(cases, "Presses", total=total, transient=True), named, cache)
    show(scored(), named)
    first = next(iter(named))
    shares = within(presses(size, THICKNESSES, NOISES, repeats, seed, kinds), first)
    by_kind = ", ".join(f"{scene} {share:.0%}" for scene, share in shares.items())
    print(f"Pressed cells within two deviations of {first}: {fmean(shares.values()):.0%}: {by_kind}")
