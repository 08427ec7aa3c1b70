"""One thing after another that goes wrong, from harmless to hopeless: what stability is tested on."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tactiled.study import faults
from tactiled.study.faults import Case, Setting

OF_PEAK = "% of the peak"
STRONGER = (0.1, 0.3, 1, 2, 5, 10, 20)
Make = Callable[[float, Setting], Iterator[Case]]


@dataclass(frozen=True, slots=True)
class Sweep:
    """One thing that goes wrong, by how much, and where it is harmless."""

    name: str
    unit: str
    values: tuple[float, ...]
    harmless: float
    make: Make
    logarithmic: bool = False
    grid: bool = False  # whether it needs rows and columns
    told: bool = True  # whether the model that restores knows of it, by its settings or by flags


SWEEPS: tuple[Sweep, ...] = (
    Sweep("cover", "t/pitch", (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1, 1.5, 2, 3, 4, 6, 10), 1, faults.cover, True),
    Sweep("white noise", OF_PEAK, (0.01, 0.03, 0.1, 0.3, 1, 2, 5, 10, 20), 0.01, faults.white, True),
    Sweep("correlated noise", OF_PEAK, STRONGER, 0.1, faults.correlated, True, grid=True, told=False),
    Sweep("row-wise noise", OF_PEAK, STRONGER, 0.1, faults.rowwise, True, grid=True, told=False),
    Sweep("offset", OF_PEAK, (-10, -5, -2, -1, 0, 1, 2, 5, 10), 0, faults.offset, told=False),
    Sweep("drift", OF_PEAK, STRONGER, 0.1, faults.drift, True, grid=True, told=False),
    Sweep(
        "noise misjudged", "true / told", (0.1, 0.2, 0.5, 1, 2, 3, 5, 10), 1, faults.misjudged, True, told=False
    ),
    Sweep("thickness wrong", "% thicker", (-30, -20, -10, -5, 0, 5, 10, 20, 30), 0, faults.thickness, told=False),
    Sweep("modulus wrong", "% stiffer", (-30, -15, 0, 15, 30), 0, faults.young, told=False),
    Sweep("Poisson's ratio wrong", "% higher", (-30, -20, -10, -5, 0, 2, 3.9), 0, faults.poisson, told=False),
    Sweep("dead taxels", "%, flagged", (0, 1, 2, 5, 10, 20), 0, faults.dead),
    Sweep("dead taxels untold", "%, read 0", (0, 0.2, 1, 2, 5, 10), 0, faults.dead_untold, told=False),
    Sweep("messages lost", "%", (0, 1, 2, 5, 10, 20), 0, faults.lost),
    Sweep(
        "saturation", "ceiling, % of the peak, flagged", (100, 90, 80, 70, 60, 50, 40, 30), 100, faults.saturated
    ),
    Sweep(
        "saturation untold",
        "ceiling, % of the peak",
        (100, 95, 90, 80, 70, 50),
        100,
        faults.saturated_untold,
        told=False,
    ),
    Sweep(
        "over the edge", "pitches past it", (-6, -4, -3, -2, -1, 0, 1, 2), -6, faults.edge, grid=True, told=False
    ),
    Sweep("quantisation", "bits", (16, 14, 12, 10, 8, 7, 6, 5, 4), 16, faults.bits),
    Sweep(
        "taxels out of place", "% of the pitch", (0, 2, 5, 10, 15, 20, 30), 0, faults.jitter, grid=True, told=False
    ),
)


def sweeps(setting: Setting) -> tuple[Sweep, ...]:
    """Those that the setting's skin allows."""
    return tuple(sweep for sweep in SWEEPS if setting.skin.array.shape is not None or not sweep.grid)
