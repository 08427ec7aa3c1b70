"""The paper's statements on the square ring and on the rod, sections IV and V."""

from collections.abc import Callable, Iterator

import numpy as np

from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack
from tactiled.study.paper import cases
from tactiled.study.paper.cases import Which, covered, under
from tactiled.study.paper.claims import BOTH, Claim, told

CORNER, SIDE, MIDDLE = (12, 12), (12, 20), (20, 20)  # elements on the ring's corner, on its side, in its hole
GREAT = 0.2  # a great change of pressure, over that on the cover
SILICONE = Layer(1.0, 2.0, 0.49)
BESIDE = 3.0  # mm from the cell's middle to the rod


def ring() -> Iterator[Claim]:
    """Fig. 8, by thickness."""
    yield Claim(
        "IV, Fig. 8(d)",
        "Under 0.1 mm the pattern is close to the original.",
        *told(_peak(0.1), "peak {:.2f}"),
        _peak(0.1)("exact") > 0.9 and _hole(0.1)("exact") < 0.1,
        "Highest pressure over that on the cover; the hole stays under a tenth of it.",
    )
    highest = max(float(covered(thickness).exact.gain.max()) for thickness in cases.THICKNESSES)
    yield Claim(
        "IV, Fig. 8(c)",
        "Under 0.2 mm the corners are enhanced.",
        *told(_corner, "{:.2f} × the side"),
        _corner("exact") > 1,
        "A corner has pressed neighbours on both its arms and keeps more than a side: the ring's geometry. "
        f"The cover enhances nothing: its gain never exceeds {highest:.3f}.",
    )
    yield Claim(
        "IV, Fig. 8(d)",
        "Under 0.4 mm the peak is lower and the profile broader.",
        *told(_peak(0.4), "peak {:.2f}"),
        _peak(0.4)("exact") < _peak(0.2)("exact"),
        f"Under 0.2 mm the peak is {_peak(0.2)('exact'):.2f}.",
    )
    yield Claim(
        "IV, Fig. 8(d)",
        "Under 0.6 mm the inner hole is dim.",
        *told(_hole(0.6), "hole {:.2f} of peak"),
        _hole(0.6)("exact") > 0.9,
        f"Under 0.4 mm it is at {_hole(0.4)('exact'):.2f}, under 0.2 mm at {_hole(0.2)('exact'):.2f} of the peak.",
    )


def materials() -> Iterator[Claim]:
    """Fig. 8, by material."""
    yield _changed("IV, Fig. 8(e)", "A modulus below the sensor's hardly changes it.", 490.0, 0.3, False)
    yield _changed("IV, Fig. 8(e)", "It differs greatly at 4903 MPa.", 4903.0, 0.3, True)
    yield _changed("IV, Fig. 8(f)", "It differs slightly with Poisson's ratio.", 98.0, 0.45, False)


def rod() -> Iterator[Claim]:
    """Fig. 10."""
    x = np.linspace(0, 4, 81)
    sheets = {which: [covered(thickness).of(which) for thickness in cases.SHEETS] for which in BOTH}
    force = {which: np.array([cases.cell_force(k, x, cases.POINT) for k in sheets[which]]) for which in BOTH}
    fem, exact = (", ".join(f"{one:.3f}" for one in force[which][:, x == BESIDE].ravel()) for which in BOTH)
    q = np.linspace(0.01, 2, 200)
    rubber = np.abs(gain(Stack((SILICONE, cases.SENSOR)), q) - sheets["exact"][-1].gain_at(q)).max()
    yield Claim(
        "V, Fig. 10",
        "Measured forces agree well with the anticipated ones.",
        f"{fem} N",
        f"{exact} N",
        None,
        "No measured number stands in the text. Given here is what to expect of a cell when the rod is "
        f"{BESIDE - cases.CELL / 2:.1f} mm beside it, under 0.25, 0.5 and 1.0 mm. Silicone rubber is nearer "
        f"2 MPa, 0.49 than the 98 MPa, 0.3 assumed; it changes the gain under 1.0 mm by up to {rubber:.2f}.",
    )
    radius = cases.rod_contact(98.0, 0.3)

    def moved(which: Which) -> float:
        spread = [cases.cell_force(cases.spread(k, radius), x, cases.POINT) for k in sheets[which]]
        return float(np.abs(spread - force[which]).max())

    yield Claim(
        "V, Fig. 10",
        "The rod's load is concentrated.",
        *told(moved, "up to {:.3f} N"),
        None,
        f"The contact is not given. Hertz's on a deep cover of 98 MPa is {radius:.2f} mm in radius, on a thin one "
        "less: that is the most by which it can change a force, near the edge of the cell.",
    )


def _peak(thickness: float) -> Callable[[Which], float]:
    """Give what measures the highest pressure under a cover of `thickness` (mm)."""
    return lambda which: float(under(covered(thickness), which).max())


def _hole(thickness: float) -> Callable[[Which], float]:
    """Give what measures the pressure in the ring's hole over the highest."""
    return lambda which: float(under(covered(thickness), which)[MIDDLE]) / _peak(thickness)(which)


def _corner(which: Which) -> float:
    """Measure the pressure on the ring's corner over that on its side under the reference cover."""
    picture = under(covered(), which)
    return float(picture[CORNER] / picture[SIDE])


def _changed(where: str, states: str, young: float, poisson: float, greatly: bool) -> Claim:
    """Measure the ring's largest change, over the pressure on the cover, from the reference cover."""

    def change(which: Which) -> float:
        return float(np.abs(under(covered(young=young, poisson=poisson), which) - under(covered(), which)).max())

    why = f"Largest change, over the pressure on the cover, from 98 MPa and 0.3 to {young:g} MPa and {poisson:g}."
    return Claim(where, states, *told(change, "change {:.2f}"), (change("exact") > GREAT) == greatly, why)
