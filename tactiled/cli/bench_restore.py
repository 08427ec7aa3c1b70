"""`tactiled bench restore`: speed and accuracy of restoration, beside scikit-image's, in one run on one thread."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.study.machine import describe
from tactiled.study.restore import OURS, Accuracy, Moving, Speed, accuracy, moving, speed
from tactiled.study.truth import DRAWN, presses

SIZES = (16, 32, 64)
THICKNESSES = (0.5, 1.0, 2.0, 3.0)  # over the pitch
NOISES = (0.002, 0.01, 0.05)  # of the frame's peak
TOLD = {
    "skimage rl 30": "sk. rl, 30",
    "skimage wiener": "sk. wiener, tuned",
    "skimage rl": "sk. rl, tuned",
    "best": "better of these",
}
WIENER_AIMS = {32: 8.0, 64: 4.0}
MOVING_AIMS = {16: "median under 40 µs", 32: "median under skimage wiener, p99 under 1 ms", 64: "p99 under 2 ms"}


def restore(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer presses, shorter timings: under 30 s.")] = False,
    repeats: Annotated[int, typer.Option(help="Random places of every scene.", min=1)] = 3,
    seed: Annotated[int, typer.Option(help="Of the random places and the noise.")] = 1,
) -> None:
    """Time our methods and scikit-image's at 16, 32 and 64 squared, and compare their errors."""
    console = Console(soft_wrap=True)
    with threadpool_limits(1):
        speeds = [speed(size, 0.1 if quick else 1.0) for size in SIZES]
        console.print(_speeds(speeds))
        console.print(_aims(speeds))
        moved = [moving(size, 60 if quick else 400) for size in SIZES]
        console.print(_moving(moved, speeds))
        console.print(_jitter(moved, speeds))
        for size in (32,) if quick else SIZES:
            covers = (1.0, 3.0) if quick else THICKNESSES
            cases = presses(size, covers, NOISES, 1 if quick else repeats, seed)
            console.print(_accuracy(accuracy(cases), size, covers))
    console.print(describe(), highlight=False)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(name, justify="right" if number else "left")
    return table


def _speeds(found: list[Speed]) -> Table:
    table = _table("Median µs a frame, one thread", "method", *(f"{each.size} x {each.size}" for each in found))
    for name in found[0].times:
        table.add_row(name, *(f"{each.times[name]:.1f}" for each in found))
    return table


def _aims(found: list[Speed]) -> Table:
    table = _table("Side by side", "ratio", *(f"{each.size} x {each.size}" for each in found), "aim")
    row = table.add_row
    aim = ", ".join(f"{least:g} at {size}" for size, least in WIENER_AIMS.items())
    row("wiener: faster than skimage's", *(f"{s.ratio('skimage wiener', 'wiener'):.1f} x" for s in found), aim)
    row("wiener: over the bare FFT pair", *(f"{s.ratio('wiener', 'FFT pair'):.2f} x" for s in found), "under 3")
    row("rl, 30: faster than skimage's", *(f"{s.ratio('skimage rl', 'rl'):.1f} x" for s in found), "8 at 32")
    return table


def _moving(found: list[Moving], speeds: list[Speed]) -> Table:
    table = _table(
        "auto on scenes that move at 100 frames a second, each frame the least of three passes",
        "µs",
        *(f"{each.size} x {each.size}" for each in found),
    )
    for name, values in (
        ("median", [each.median for each in found]),
        ("99th percentile", [each.p99 for each in found]),
        ("worst", [each.worst for each in found]),
        ("skimage wiener", [each.times["skimage wiener"] for each in speeds]),
        ("idle pad (aim: under 5)", [each.idle for each in found]),
    ):
        table.add_row(name, *(f"{value:.1f}" for value in values))
    chosen = (sorted(each.chosen.items()) for each in found)
    table.add_row("chosen", *(", ".join(f"{name} {count}" for name, count in each) for each in chosen))
    table.add_row("aim", *(MOVING_AIMS[each.size] for each in found))
    return table


def _jitter(found: list[Moving], speeds: list[Speed]) -> Table:
    table = _table(
        "99.9th percentile over median: on the worst of these scenes but for its first frame (aim: under 5); "
        "of one frame over and over as it comes",
        "method",
        *(f"{each.size} x {each.size}" for each in found),
        *(f"one, {each.size} x {each.size}" for each in speeds),
    )
    for name in ("FFT pair", *found[0].jitter):
        moved = (f"{each.jitter[name]:.1f} x" if name in each.jitter else "" for each in found)
        table.add_row(name, *moved, *(f"{each.jitter[name]:.1f} x" for each in speeds))
    return table


def _accuracy(found: Accuracy, size: int, covers: tuple[float, ...]) -> Table:
    title = (
        f"NRMSE at {size} x {size}, {len(found.presses)} presses, t/pitch {covers}, noise 0.2, 1, 5 %; "
        "over: at worst, over the raw image's; > 2 %: presses worse than raw by more"
    )
    table = Table(title=title, title_justify="left", box=None, padding=(0, 0, 0, 1))
    table.add_column()
    for name in (*DRAWN, "mean", "over", "> 2 %"):
        table.add_column(name, justify="right", no_wrap=True)
    for name in ("raw", *OURS, "skimage rl 30", "skimage wiener", "skimage rl", "best"):
        errors = [f"{found.mean(name, scene):.3f}".lstrip("0") for scene in (*DRAWN, None)]
        table.add_row(TOLD.get(name, name), *errors, f"{found.worst(name):.2f}", f"{found.slips(name)}")
    return table
