"""`tactiled bench cover`: how right and how fast covers are solved."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.study.cover import Times, Trial, sweep, times
from tactiled.study.machine import describe


def cover(
    stacks: Annotated[int, typer.Option(help="How many random stacks.", min=1)] = 200,
    seed: Annotated[int, typer.Option(help="Of the random stacks.", min=0)] = 1,
) -> None:
    """Hold finite elements against the exact gain of random stacks, and time the paper's cover, on one core."""
    console = Console(soft_wrap=True, highlight=False)
    with threadpool_limits(1):
        taken = times()
        trials = list(sweep(stacks, seed))
    console.print(_table(trials, taken))
    solved = [trial for trial in trials if not trial.refusal]
    if solved:
        worst = max(solved, key=lambda trial: trial.error)
        console.print(f"Worst error: {worst.stack}; {worst.unknowns} unknowns.")
    for trial in trials:
        if trial.refusal:
            console.print(f"Refused: {trial.stack}: {trial.refusal}.")


def _table(trials: list[Trial], taken: Times) -> Table:
    solved = [trial for trial in trials if not trial.refusal]
    table = Table(title=f"Covers at 1e-3, {len(trials)} random stacks", caption=describe())
    for name in ("figure", "measured", "aim"):
        table.add_column(name)
    if solved:
        table.add_row(
            "worst |G_fem − G_exact| where G ≥ 1e-3", f"{max(one.error for one in solved):.1e}", "1e-3 or less"
        )
        table.add_row("worst true error / estimate", f"{max(one.ratio for one in solved):.2f}", "2 or less")
    table.add_row("refused with an error", f"{len(trials) - len(solved)}", "0")
    seconds = sorted(one.seconds for one in trials)
    table.add_row(
        "a random stack, median / longest", f"{seconds[len(seconds) // 2]:.2f} / {seconds[-1]:.2f} s", ""
    )
    table.add_row(
        "the paper's cover, first / median", f"{_ms(taken.first)} / {_ms(taken.cold)} ms", "under 300 ms"
    )
    table.add_row("the paper's cover, from cache", f"{_ms(taken.warm)} ms", "under 5 ms")
    table.add_row("exact gain, 256 frequencies, two layers", f"{_ms(taken.exact)} ms", "under 5 ms")
    return table


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.3g}"
