"""How every chart looks: one set of colours that the colour-blind can tell apart, units on every axis."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactiled.cover.kernel import Kernel
from tactiled.errors import ConfigError
from tactiled.files import whole_file

# Okabe and Ito's palette, its yellow left out: too faint on white. Dashes tell the lines apart in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9")
MARKS = ("o", "s", "^", "D", "v", "P")
BLUE, RED, GREEN, PINK, BLACK, SKY = COLOURS
OURS = {  # mark and colour of our methods, in the order of legends
    "auto": ("*", BLACK),
    "wiener": ("o", BLUE),
    "nnls": ("^", GREEN),
    "tv": ("d", GREEN),
    "points": ("v", PINK),
    "learned": ("h", PINK),
    "rl": ("s", RED),
}
WORSE_COLOUR = "#FBEEE6"  # background of what is worse than the raw image, or under the noise
FREQUENCY = "spatial frequency q (cycles/mm)"
STYLE = Path(__file__).with_suffix(".mplstyle")


@contextmanager
def figure(path: Path, width: float, height: float) -> Iterator[Figure]:
    """Draw a figure of width x height inches into `path`; its ending says whether as SVG, PNG or PDF."""
    if path.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise ConfigError(f"picture {path}: give a name that ends in .svg, .png or .pdf")
    with mpl.rc_context(fname=STYLE):
        chart = Figure(figsize=(width, height), layout="constrained")
        yield chart
        with whole_file(path, replace=True) as part:
            chart.savefig(part, metadata={"Date": None} if path.suffix.lower() == ".svg" else None)


def two_models(path: Path, fem: Kernel, exact: Kernel) -> None:
    """Draw g(r) and G(q) by finite elements and exactly, and the difference of the gains."""
    depth = fem.stack.depth
    end = float(exact.q[np.flatnonzero(np.abs(exact.gain) >= 1e-3)[-1]])
    q, r = np.linspace(0, end, 240), np.linspace(0, 3 * depth, 240)
    with figure(path, 11, 4.1) as chart:
        chart.suptitle(str(fem.stack), fontsize=10.5, x=0.01, ha="left")
        response, gain, error = chart.subplots(1, 3)
        _pair(response, r, [np.interp(r, each.r, each.g) for each in (exact, fem)])
        response.set(title="Point response g(r)", xlabel="distance from the load r (mm)", ylabel="g (1/mm²)")
        _pair(gain, q, [each.gain_at(q) for each in (exact, fem)])
        gain.set(title="Gain G(q)", xlabel=FREQUENCY, ylabel="G")
        error.plot(q, (fem.gain_at(q) - exact.gain_at(q)) * 1e3, label="difference")
        estimate = fem.error_estimate * 1e3
        error.axhspan(-estimate, estimate, color="#0072B2", alpha=0.12, lw=0, label="error estimate")
        error.set(title="Finite elements − exact", xlabel=FREQUENCY, ylabel="error of G (10⁻³)")
        error.set(xlim=(0, None), ylim=(-1.5 * estimate, 1.5 * estimate))
        error.legend(loc="upper right", ncols=2, columnspacing=1.2)


def _pair(axes: Axes, x: Any, values: list[Any]) -> None:
    """Draw the exact solution as a line and the finite elements as marks on it."""
    axes.plot(x, values[0], label="exact")
    axes.plot(x, values[1], "o", mfc="none", markevery=12, label="finite elements")
    axes.set_xlim(0, None)
    axes.legend()
