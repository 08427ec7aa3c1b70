"""Draw frontier.svg and stability.svg: a part of the charts of `tactiled bench report`, in a few minutes."""

from pathlib import Path

from threadpoolctl import threadpool_limits

from tactiled.bench import faults, frontier, stability
from tactiled.bench.skin import rubber

SWEEPS = ("cover", "white noise", "thickness wrong", "dead taxels", "over the edge", "taxels out of place")
FOLDER = Path(__file__).parent

with threadpool_limits(1):
    panels = frontier.measure([rubber(thickness, 32) for thickness in (1.0, 3.0)], False, 1)
    frontier.draw(FOLDER / "frontier.svg", panels)
    faults.SWEEPS = tuple(sweep for sweep in faults.SWEEPS if sweep.name in SWEEPS)
    stability.draw(FOLDER / "stability.svg", stability.measure(stability.setting(False, 1)))
