"""The paper's figures, drawn anew: lines are exact, marks are finite elements."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from tactiled.arrays import Floats
from tactiled.bench.paper import models
from tactiled.bench.paper.models import covered
from tactiled.charts.style import COLOURS, FREQUENCY, MARKS
from tactiled.cover.fem import FLOOR
from tactiled.cover.kernel import Kernel

Q = np.linspace(0, 6, 301)  # cycles/mm
SPACING = 20  # points of a line between marks

NINE = {f"Thickness {thickness:g} mm": (thickness, 98.0, 0.3) for thickness in (0.1, 0.4, 0.6)}
NINE |= {f"Modulus {young:g} MPa": (0.2, young, 0.3) for young in (490.0, 980.0, 4903.0)}
NINE |= {f"Poisson's ratio {poisson:g}": (0.2, 98.0, poisson) for poisson in (0.2, 0.4, 0.45)}


def _models(thickness: float = 0.2, **cover: float) -> list[Kernel]:
    """A cover solved exactly, and by finite elements."""
    return [covered(model, thickness, **cover) for model in models.MODELS]


def _point_load(chart: Figure) -> None:
    """Stress under the paper's point load, and its peaks against the law they should follow."""
    r = np.linspace(0, 1, 301)
    main, side = chart.subplots(1, 2, width_ratios=(1.5, 1))
    pairs = [_models(thickness) for thickness in models.THICKNESSES]
    for number, (thickness, pair) in enumerate(zip(models.THICKNESSES, pairs, strict=True)):
        _both(main, number, r, [models.LOAD * np.interp(r, each.r, each.g) for each in pair], f"{thickness:g} mm")
    main.set(xlabel="distance from the load r (mm)", ylabel="stress under 0.98 N (MPa)", yscale="log")
    main.set(title="Stress on the sensor, by thickness", xlim=(0, 1), ylim=(1e-2, 100))
    main.legend(title="cover")
    peaks = [models.LOAD * exact.g[0] for exact, _ in pairs]
    law = peaks[1] * (models.THICKNESSES[1] / np.array(models.THICKNESSES)) ** 2
    side.loglog(models.THICKNESSES, law, "--", color="#888888", label="1 / thickness²")
    side.loglog(models.THICKNESSES, peaks, "o", color=COLOURS[0], markersize=7, label="peak, exact")
    side.set(title="Its peak", xlabel="thickness (mm)", ylabel="peak stress (MPa)")
    side.set_xticks(models.THICKNESSES, [f"{thickness:g}" for thickness in models.THICKNESSES])
    side.set_yticks(peaks, [f"{peak:.3g}" for peak in peaks])
    side.minorticks_off()
    side.legend()


def _gains(chart: Figure, layer_property: str, values: tuple[float, ...], name: str, unit: str) -> None:
    """A gain for every value, with the error of the finite elements beside it."""
    main, side = chart.subplots(1, 2, width_ratios=(1.5, 1))
    for number, value in enumerate(values):
        exact, fem = (each.gain_at(Q) for each in _models(**{layer_property: value}))
        _both(main, number, Q, [exact, fem], f"{value:g} {unit}")
        error = np.where(exact >= FLOOR, fem - exact, np.nan)
        look: Any = {"color": COLOURS[number], "marker": MARKS[number], "mfc": "white", "lw": 1.2}
        side.plot(Q, error * 1e3, markevery=(13 * number % 60 + 8, 60), **look)
    _gain_axes(main, name, "cover")
    side.set(title="Finite elements − exact", xlabel=FREQUENCY, ylabel="error of G (10⁻³)")
    side.set(xlim=(0, 6), ylim=(-1.1, 1.1), yticks=(-1, -0.5, 0, 0.5, 1))
    for aim in (-1, 1):
        side.axhline(aim, color="#444444", lw=1, ls=(0, (4, 3)))
    side.text(5.9, 0.97, "aim: ±1", ha="right", va="top", fontsize=9.5, color="#444444")


def _ratios(chart: Figure) -> None:
    """Gain by Poisson's ratio, and how far each ratio is from the paper's 0.3."""
    main, side = chart.subplots(1, 2)
    reference = [each.gain_at(Q) for each in _models()]
    for number, poisson in enumerate(models.RATIOS):
        values = [each.gain_at(Q) for each in _models(poisson=poisson)]
        _both(main, number, Q, values, f"{poisson:g}")
        _both(side, number, Q, list(np.subtract(values, reference)), f"{poisson:g}")
    _gain_axes(main, "Poisson's ratio", "Poisson's ratio")
    side.set(title="Change from ratio 0.3", xlabel=FREQUENCY, ylabel="change of G", xlim=(0, 6))


def _gain_axes(axis: Axes, name: str, legend: str) -> None:
    axis.set(title=f"Gain by {name} of the cover", xlabel=FREQUENCY, ylabel="gain G", xlim=(0, 6), ylim=(0, 1.03))
    axis.legend(title=legend)


def _ring(chart: Figure) -> None:
    """The square ring, the reference cover, and nine that differ from it."""
    axes = chart.subplots(4, 3)
    image = _picture(axes[0, 0], models.ring(), "On the cover")
    _picture(axes[0, 1], models.under(covered("fem")), "0.2 mm, 98 MPa, ratio 0.3")
    _section(axes[0, 2])
    for axis, (title, cover) in zip(axes[1:].flat, NINE.items(), strict=True):
        _picture(axis, models.under(covered("fem", *cover)), title)
    for axis in (*axes[:3, :2].flat, *axes[1:3, 2]):
        axis.set_xlabel("")
    for axis in (axes[0, 1], *axes[1:, 1:].flat):
        axis.set_ylabel("")
    label = "pressure on the sensor over that on the cover"
    chart.colorbar(image, ax=axes, location="bottom", aspect=45, shrink=0.7, label=label, pad=0.02)


def _picture(axis: Axes, pressure: Floats, title: str) -> AxesImage:
    """Draw a pressure on 2 x 2 mm, every picture on one scale."""
    image = axis.imshow(pressure, extent=(-1, 1, -1, 1), cmap="cividis", vmin=0, vmax=1)
    axis.set_title(title, fontsize=11)
    axis.set(xlabel="x (mm)", ylabel="y (mm)", xticks=(-1, 0, 1), yticks=(-1, 0, 1))
    axis.grid(visible=False)
    return image


def _section(axis: Axes) -> None:
    """Draw the cut through the ring's middle, on the cover and under four thicknesses."""
    x = models.centres()
    middle = models.ELEMENTS // 2
    axis.step(x, models.ring()[middle], where="mid", color="#999999", lw=1.2, label="cover")
    for number, thickness in enumerate(models.THICKNESSES):
        cut = [models.under(each)[middle] for each in _models(thickness)]
        _both(axis, number, x, cut, f"{thickness:g} mm", 5)
    axis.set_title("Cut at y = 0", fontsize=11)
    axis.set(xlabel="x (mm)", ylabel="pressure ratio", xlim=(-1, 1), ylim=(0, 1.75), xticks=(-1, 0, 1))
    axis.set_yticks((0, 0.5, 1))
    axis.set_box_aspect(1)
    axis.legend(fontsize=9, ncols=2, loc="upper center", columnspacing=1.2, handlelength=1.6)


def _rod(chart: Figure) -> None:
    """Force on one cell, and faintly on its neighbours, as the rod moves along the row."""
    x = np.linspace(-6, 6, 481)
    main, side = chart.subplots(1, 2)
    for number, thickness in enumerate(models.SHEETS):
        pair = _models(thickness)
        forces = [models.cell_force(each, x, models.POINT) for each in pair]
        _both(main, number, x, forces, f"{thickness:g} mm", 40)
        _both(side, number, x, forces, f"{thickness:g} mm", 12)
        for offset in (-models.CELL, models.CELL):
            beside = models.cell_force(pair[0], x - offset, models.POINT)
            main.plot(x, beside, color=COLOURS[number], lw=1, alpha=0.4)
    for axis in (main, side):
        axis.axvspan(-models.CELL / 2, models.CELL / 2, color="#999999", alpha=0.15, lw=0, label="the cell")
        axis.set(xlabel="place of the rod (mm)", ylabel="force on the cell (N)", ylim=(-0.02, 1.03))
    main.set(title="One cell of the row, and its neighbours", xlim=(-6, 6))
    side.set(title="At the cell's edge", xlim=(1, 3.6))
    side.legend(title="rubber", loc="upper right")


def _both(axis: Axes, number: int, x: Floats, values: list[Floats], label: str, spacing: int = SPACING) -> None:
    """Draw the exact values as a line and the finite elements' as marks on it."""
    look: Any = {"marker": MARKS[number], "color": COLOURS[number], "mfc": "white"}
    axis.plot(x, values[0], color=COLOURS[number])
    axis.plot([], [], label=label, **look)
    axis.plot(x, values[1], ls="", markevery=(3 * number % spacing, spacing), **look)


_by_thickness = partial(_gains, layer_property="thickness", values=models.THICKNESSES, name="thickness", unit="mm")
_by_modulus = partial(_gains, layer_property="young", values=models.MODULI, name="Young's modulus", unit="MPa")
FIGURES: tuple[tuple[str, float, Callable[[Figure], None], str, str], ...] = (  # file, inches high, plot, caption
    ("fig04.svg", 4.2, _point_load, "Fig. 4", "Stress on the sensor under a point load of 0.98 N, by thickness."),
    ("fig05.svg", 4.2, _by_thickness, "Fig. 5",
     "Gain by thickness; error of the finite elements where it is 0.001 or more."),
    ("fig06.svg", 4.2, _by_modulus, "Fig. 6",
     "Gain by the cover's Young's modulus, and the error of the finite elements."),
    ("fig07.svg", 4.2, _ratios, "Fig. 7",
     "Gain by the cover's Poisson's ratio, and the difference from that at 0.3."),
    ("fig08.png", 12.6, _ring, "Fig. 8", "A square ring under the reference cover and under nine others."),
    ("fig10.svg", 4.4, _rod, "Fig. 10",
     "Force on a cell of 4.57 mm as a rod with 0.98 N moves along; pale: others."),
)  # fmt: skip
