"""The charts of `tactiled calibrate`: a fitted gain, and the response under a fitted cover."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from tactiled.calibrate.counts.gain import GainFit
from tactiled.calibrate.cover.fit import CoverFit
from tactiled.charts.style import BLUE, COLOURS, RED, figure
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError

MAX_TAXELS_DRAWN = 6  # by their gains, from the lowest to the highest
AXES = {
    "tip": ("distance from the tip's middle (mm)", "pressure over the response's peak"),
    "edge": ("distance into the load (mm)", "pressure over the load's"),
}
SKIRT, SKIRT_END = 2.0, 0.05  # the plot ends at twice the distance at which the response is 0.05 of its peak


def draw_gain(path: Path, fit: GainFit) -> None:
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


def _taxels(axes: Axes, fit: GainFit) -> None:
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


def draw_cover(path: Path, fit: CoverFit, configured: Stack) -> None:
    """Draw every reading against its distance from the load, what is fitted to it, and what is left."""
    if fit.line is None:
        raise ConfigError(f"picture {path}: there is no line along which a fit by {fit.method} can be drawn")
    x, measured, fitted = fit.line
    low, high = fit.interval_mm
    with figure(path, 11, 4.4) as chart:
        chart.suptitle(
            f"cover {fit.thickness_mm:.4g} mm (95 %: {low:.4g} to {high:.4g}), "
            f"configured {configured.depth:.4g} mm; {fit.presses} presses",
            fontsize=10.5,
            x=0.01,
            ha="left",
        )
        response, residual = chart.subplots(1, 2)
        across, along = AXES[fit.method]
        response.plot(x, measured, "o", mfc="none", color=BLUE, ms=4, alpha=0.6, label="measured")
        response.plot(x, fitted, ".", color=RED, ms=3, label="fitted")
        response.set(xlabel=across, ylabel=along, title="Response")
        if fit.method == "tip":
            response.set_xlim(0, SKIRT * x[fitted > SKIRT_END].max())
        response.legend()
        residual.plot(x, 100 * (measured - fitted), ".", color=BLUE, ms=3, label="a reading")
        residual.axhline(0, color="0.5", lw=0.8)
        residual.set(xlabel=across, ylabel="measured − fitted (%)", title="Residual")
        residual.legend()
        ends = np.percentile(100 * (measured - fitted), [0.2, 99.8])
        residual.set_ylim(1.5 * min(ends[0], -0.1), 1.5 * max(ends[1], 0.1))
