"""`tactiled bench picard`: what an array under a cover can know at all."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from tactiled.cli.bench_frontier import made


def picard(
    config: Annotated[Path | None, typer.Option(help="Configuration whose array and cover to look at.")] = None,
    sensor: Annotated[str | None, typer.Option(help="Its sensor; the first if left out.")] = None,
    noise: Annotated[float, typer.Option(help="Of a taxel, % of the frame's peak.", min=1e-6, max=100)] = 1.0,
    out: Annotated[Path, typer.Option(help="Folder for picard.svg.")] = Path("bench"),
    seed: Annotated[int, typer.Option(help="Of the scene's places and the noise.", min=0)] = 1,
) -> None:
    """Draw the singular values of an array under its cover, and which of a scene's modes rise above the noise."""
    from tactiled.study import picard as measure
    from tactiled.study.skin import configured, rubber

    folder = made(out)
    with threadpool_limits(1):
        skins = [configured(config, sensor)] if config else [rubber(t, 32) for t in (0.5, 1.0, 2.0, 3.0)]
        found = [measure.measure(skin, noise / 100, seed) for skin in skins]
    measure.draw(folder / "picard.svg", found)
    console = Console(soft_wrap=True, highlight=False)
    for one in found:
        console.print(
            f"{one.skin}: {one.clear} of {one.singular.size} modes of the scene {one.scene!r} rise above a noise"
            f" of {noise:g} % of the peak; the finest has a half-period of {one.resolution_mm:.2f} mm"
        )
    console.print(f"Seed {seed}. Written: {folder}/picard.svg")
