"""The paper's figures, drawn anew: lines are exact, marks are finite elements."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from tactiled.bench.charts import COLOURS, MARKS, figure
from tactiled.bench.paper import cases
from tactiled.bench.paper.cases import Pair, covered

Q = np.linspace(0, 6, 301)  # cycles/mm
SPACING = 20  # lines' points between marks

NINE = (  # thickness (mm), Young's modulus (MPa), Poisson's ratio
    *((thickness, 98.0, 0.3) for thickness in (0.1, 0.4, 0.6)),
    *((0.2, young, 0.3) for young in (490.0, 980.0, 4903.0)),
    *((0.2, 98.0, poisson) for poisson in (0.2, 0.4, 0.45)),
)


def response_by_thickness(path: Path) -> None:
    """Fig. 4: stress under the paper's point load, and its peaks against the law they should follow."""
    r = np.linspace(0, 1, 301)
    with figure(path, 10, 4.2) as drawn:
        left, right = drawn.subplots(1, 2, width_ratios=(1.5, 1))
        pairs = [covered(thickness) for thickness in cases.THICKNESSES]
        for number, (thickness, pair) in enumerate(zip(cases.THICKNESSES, pairs, strict=True)):
            values = [cases.LOAD * np.interp(r, each.r, each.g) for each in (pair.exact, pair.fem)]
            _both(left, number, r, values, f"{thickness:g} mm")
        left.set(xlabel="distance from the load r (mm)", ylabel="stress under 0.98 N (MPa)", yscale="log")
        left.set(title="Stress on the sensor, by thickness", xlim=(0, 1), ylim=(1e-2, 100))
        left.legend(title="cover")
        peaks = [cases.LOAD * pair.exact.g[0] for pair in pairs]
        law = peaks[1] * (cases.THICKNESSES[1] / np.array(cases.THICKNESSES)) ** 2
        right.loglog(cases.THICKNESSES, law, "--", color="#888888", label="1 / thickness²")
        right.loglog(cases.THICKNESSES, peaks, "o", color=COLOURS[0], markersize=7, label="peak, exact")
        right.set(title="Its peak", xlabel="thickness (mm)", ylabel="peak stress (MPa)")
        right.set_xticks(cases.THICKNESSES, [f"{thickness:g}" for thickness in cases.THICKNESSES])
        right.set_yticks(peaks, [f"{peak:.3g}" for peak in peaks])
        right.minorticks_off()
        right.legend()


def gain_by_thickness(path: Path) -> None:
    """Fig. 5."""
    _gains(path, "Gain by thickness of the cover", cases.THICKNESSES, lambda x: covered(x), "{:g} mm")


def gain_by_modulus(path: Path) -> None:
    """Fig. 6."""
    _gains(path, "Gain by Young's modulus of the cover", cases.MODULI, lambda x: covered(young=x), "{:g} MPa")


def gain_by_poisson(path: Path) -> None:
    """Fig. 7, and how far each ratio is from the paper's 0.3."""
    with figure(path, 10, 4.2) as drawn:
        left, right = drawn.subplots(1, 2)
        reference = covered()
        for number, poisson in enumerate(cases.RATIOS):
            pair = covered(poisson=poisson)
            values = [pair.exact.gain_at(Q), pair.fem.gain_at(Q)]
            _both(left, number, Q, values, f"{poisson:g}")
            change = [values[0] - reference.exact.gain_at(Q), values[1] - reference.fem.gain_at(Q)]
            _both(right, number, Q, change, f"{poisson:g}")
        _gain_axes(left, "Gain by Poisson's ratio of the cover")
        left.legend(title="Poisson's ratio")
        right.set(
            title="Change from ratio 0.3", xlabel="spatial frequency q (cycles/mm)", ylabel="ΔG", xlim=(0, 6)
        )
        right.axhline(0, color="#444444", lw=0.8)


def ring_under_covers(path: Path) -> None:
    """Fig. 8: the square ring, the reference cover, and nine that differ from it."""
    with figure(path, 10, 13) as drawn:
        axes = drawn.subplots(4, 3)
        image = _picture(axes[0, 0], cases.ring(), "Pressure on the cover")
        _picture(axes[0, 1], cases.under(covered(), "fem"), "Under 0.2 mm, 98 MPa, 0.3")
        _section(axes[0, 2])
        for axis, (thickness, young, poisson) in zip(axes[1:].flat, NINE, strict=True):
            shown = cases.under(covered(thickness, young, poisson), "fem")
            _picture(axis, shown, _difference(thickness, young, poisson))
        drawn.colorbar(image, ax=axes, shrink=0.5, label="pressure over that on the cover", pad=0.02)


def rod_over_cells(path: Path) -> None:
    """Fig. 10: force on one cell as the rod moves along the row."""
    x = np.linspace(-8, 8, 321)
    with figure(path, 10, 4.2) as drawn:
        left, right = drawn.subplots(1, 2)
        for number, thickness in enumerate(cases.SHEETS):
            pair = covered(thickness)
            forces = [cases.cell_force(each, x, 0.02) for each in (pair.exact, pair.fem)]
            _both(left, number, x, forces, f"{thickness:g} mm")
            _both(right, number, x, forces, f"{thickness:g} mm", 6)
        for axis in (left, right):
            axis.axvspan(-cases.CELL / 2, cases.CELL / 2, color="#999999", alpha=0.15, lw=0, label="the cell")
            axis.set(xlabel="place of the rod (mm)", ylabel="force on the cell (N)")
        left.set(title="Force on one cell of 4.57 mm, rod of 0.98 N", xlim=(-8, 8))
        right.set(title="The same, at the cell's edge", xlim=(0.8, 3.8))
        left.legend(title="rubber", loc="upper right")


def _gains(path: Path, title: str, of: Sequence[float], pair: Callable[[float], Pair], name: str) -> None:
    """Draw one gain for every value, with the error of the finite elements beside it."""
    with figure(path, 10, 4.2) as drawn:
        left, right = drawn.subplots(1, 2, width_ratios=(1.5, 1))
        for number, value in enumerate(of):
            exact, fem = pair(value).exact.gain_at(Q), pair(value).fem.gain_at(Q)
            _both(left, number, Q, [exact, fem], name.format(value))
            right.plot(Q, (fem - exact) * 1e3, color=COLOURS[number], lw=1.2)
        _gain_axes(left, title)
        left.legend(title="cover")
        right.set(title="Finite elements less exact", xlabel="spatial frequency q (cycles/mm)", xlim=(0, 6))
        right.set(ylabel="ΔG (10⁻³); the aim is ±1", ylim=(-1, 1))


def _gain_axes(axis: Axes, title: str) -> None:
    axis.set(title=title, xlabel="spatial frequency q (cycles/mm)", ylabel="gain G", xlim=(0, 6), ylim=(0, 1.03))


def _both(
    axis: Axes, number: int, x: cases.Floats, values: list[cases.Floats], label: str, spacing: int = SPACING
) -> None:
    """Draw the exact values as a line and the finite elements' as marks on it."""
    colour = COLOURS[number]
    axis.plot(x, values[0], color=colour)
    axis.plot(
        x,
        values[1],
        MARKS[number],
        color=colour,
        mfc="white",
        markevery=(3 * number % spacing, spacing),
        label=label,
    )


def _picture(axis: Axes, pressure: cases.Floats, title: str) -> AxesImage:
    """Draw a pressure on 2 x 2 mm, every picture on one scale."""
    image = axis.imshow(pressure, extent=(-1, 1, -1, 1), cmap="cividis", vmin=0, vmax=1)
    axis.set_title(title, fontsize=10.5)
    axis.set(xlabel="x (mm)", ylabel="y (mm)", xticks=(-1, 0, 1), yticks=(-1, 0, 1))
    axis.grid(visible=False)
    return image


def _section(axis: Axes) -> None:
    """Draw the cut through the ring's middle, on the cover and under four thicknesses."""
    x = (np.arange(cases.ELEMENTS) - (cases.ELEMENTS - 1) / 2) * cases.ELEMENT
    middle = cases.ELEMENTS // 2
    axis.step(x, cases.ring()[middle], where="mid", color="#999999", lw=1.2, label="on the cover")
    for number, thickness in enumerate(cases.THICKNESSES):
        axis.plot(
            x, cases.under(covered(thickness), "fem")[middle], color=COLOURS[number], label=f"{thickness:g} mm"
        )
    axis.set_title("Cut at y = 0", fontsize=10.5)
    axis.set(xlabel="x (mm)", ylabel="pressure", xlim=(-1, 1), ylim=(-0.05, 1.75))
    axis.legend(fontsize=8.5, ncols=2, loc="upper center")


def _difference(thickness: float, young: float, poisson: float) -> str:
    """Name what differs from the reference cover."""
    if thickness != 0.2:
        return f"Thickness {thickness:g} mm"
    return f"Young's modulus {young:g} MPa" if young != 98.0 else f"Poisson's ratio {poisson:g}"


FIGURES: tuple[tuple[str, str, str, Callable[[Path], None]], ...] = (
    ("fig04.svg", "Fig. 4", "Stress under a point load, by thickness of the cover.", response_by_thickness),
    ("fig05.svg", "Fig. 5", "Gain by thickness.", gain_by_thickness),
    ("fig06.svg", "Fig. 6", "Gain by the cover's Young's modulus.", gain_by_modulus),
    ("fig07.svg", "Fig. 7", "Gain by the cover's Poisson's ratio.", gain_by_poisson),
    ("fig08.png", "Fig. 8", "A square ring of pressure under ten covers, by finite elements.", ring_under_covers),
    ("fig10.svg", "Fig. 10", "A rod over a row of pressure cells under rubber.", rod_over_cells),
)
