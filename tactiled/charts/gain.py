"""The chart of a fitted gain: counts against pressure, and what the curves leave."""

from pathlib import Path

import numpy as np

from tactiled.calibrate.counts.gain import GainFit
from tactiled.charts.style import BLUE, COLOURS, RED, figure

MAX_TAXELS_DRAWN = 6  # by their gains, from the lowest to the highest


def draw(path: Path, fit: GainFit) -> None:
    """Draw counts over pressure of some taxels, and the residuals of all; of a force, fitted over known load."""
    points, rising = fit.points, fit.points.direction >= 0
    uniform = fit.force_n is None
    load = points.pressure if fit.force_n is None else fit.force_n
    what, unit = ("pressure", "kPa") if uniform else ("force", "N")
    with figure(path, 11, 4.4) as chart:
        curves, residuals = chart.subplots(1, 2)
        if uniform:
            _taxels(curves, fit)
        else:
            fitted = load * (1 + fit.residuals[:, 0] / points.pressure)
            curves.plot(load, fitted, ".", color=BLUE, label="measured")
            curves.plot([0, load.max()], [0, load.max()], color="0.5", label="equal")
            curves.set(xlabel="known force (N)", ylabel="sum of the taxels' forces (N)")
            curves.legend()
        percent = 100 * fit.residuals / points.pressure.max()
        for some, colour, name in ((rising, BLUE, "rising"), (~rising, RED, "falling")):
            if some.any():
                across = np.repeat(load[some], percent.shape[1])
                residuals.plot(across, percent[some].ravel(), ".", color=colour, alpha=0.3, ms=3)
                residuals.plot([], [], "o", color=colour, label=f"{name} {what}")
        residuals.axhline(0, color="0.5", lw=0.8)
        residuals.set(xlabel=f"known {what} ({unit})", ylabel="fitted − known (% of the largest)", xlim=(0, None))
        residuals.set_title("Residuals" + (" of all taxels" if uniform else ""))
        residuals.legend()


def _taxels(axes, fit: GainFit) -> None:  # type: ignore[no-untyped-def]
    """Draw some taxels' points, hollow while pressure falls, and their curves."""
    curves, rising = fit.curves, fit.points.direction >= 0
    counts = np.sign(curves.gain) * fit.points.counts[..., 0]
    live = np.setdiff1d(np.arange(curves.size), fit.dead)
    order = live[np.argsort(np.abs(curves.gain[live]))]
    some = order[np.unique(np.linspace(0, order.size - 1, MAX_TAXELS_DRAWN).astype(int))]
    ends = np.array([end[np.abs(end).argmax()] for end in curves.reach_counts])
    line = np.linspace(0, 1, 100)[:, None] * ends
    pressure = curves.pressure(line)
    for taxel, colour in zip(some, COLOURS, strict=False):
        axes.plot(pressure[:, taxel], line[:, taxel], color=colour, lw=1, label=f"taxel {taxel}")
        axes.plot(fit.points.pressure[rising], counts[rising, taxel], "o", color=colour, ms=4)
        axes.plot(fit.points.pressure[~rising], counts[~rising, taxel], "o", mfc="none", color=colour, ms=4)
    axes.set(xlabel="pressure (kPa)", ylabel="counts over no load", title="Curves; hollow: falling pressure")
    axes.legend()
