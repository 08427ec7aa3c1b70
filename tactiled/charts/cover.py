"""The chart of a fitted cover: the response, measured and fitted, along a line."""

from pathlib import Path

import numpy as np

from tactiled.calibrate.cover.fit import CoverFit
from tactiled.charts.style import BLUE, RED, figure
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError

AXES = {
    "tip": ("distance from the tip's middle (mm)", "pressure over the response's peak"),
    "edge": ("distance into the load (mm)", "pressure over the load's"),
}
SKIRT, SKIRT_END = 2.0, 0.05  # the plot ends at so many times the distance where the response is so low


def draw(path: Path, fit: CoverFit, configured: Stack) -> None:
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
