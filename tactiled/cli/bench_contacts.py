"""`tactiled bench contacts`: how well contacts are found, raw against restored."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.study.contacts import Found, measure
from tactiled.study.machine import describe

THICKNESSES = (0.5, 1.0, 2.0, 3.0)  # over the pitch
NOISES = (0.002, 0.01, 0.05)  # of the frame's peak


def contacts(
    repeats: Annotated[
        int, typer.Option(help="Discs at random places; half as many pairs at every gap.", min=4)
    ] = 40,
    seed: Annotated[int, typer.Option(help="Of the random places and the noise.", min=0)] = 1,
) -> None:
    """Press discs into a 24 x 24 array of 1 mm pitch, one and two at a time, and look for them in both images."""
    table = Table(title="Contacts found in the raw and in the restored image", title_justify="left")
    for name in ("t/pitch, noise", "found, %", "centre, mm", "95 %, mm", "force, %", "gap, mm"):
        table.add_column(name, justify="left" if name.startswith("t/") else "right")
    with threadpool_limits(1):
        for thickness in THICKNESSES:
            for noise in NOISES:
                raw, restored = measure(thickness, noise, repeats, seed)
                table.add_row(f"{thickness:g}, {100 * noise:g} %", *_cells(raw, restored))
    console = Console(soft_wrap=True, highlight=False)
    console.print(table)
    console.print(
        "Each raw / restored: single discs found as one contact; how far their centre is off, median and 95th"
        " percentile; how far their force is, median; smallest gap between two discs that are told apart."
        f"\n{repeats} discs, seed {seed}. {describe()}"
    )


def _cells(raw: Found, restored: Found) -> list[str]:
    both = raw, restored
    return [
        " / ".join(f"{100 * each.one:.0f}" for each in both),
        " / ".join(f"{each.off_mm:.3f}" for each in both),
        " / ".join(f"{each.far_mm:.3f}" for each in both),
        " / ".join(f"{100 * each.force:.1f}" for each in both),
        " / ".join(f"{each.gap_mm:g}" for each in both),
    ]
