"""The paper's statements, each compared with both models."""

from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np

from tactiled.bench.paper import models
from tactiled.bench.paper.models import Model, cell_force, covered, under

Q = np.linspace(0.1, 6, 591)  # cycles/mm
CORNER, SIDE, MIDDLE = (12, 12), (12, 20), (20, 20)  # elements on the ring's corner, on its side, in its hole
ROD_X = np.linspace(0, 4, 81)  # mm from the cell's middle to the rod
BESIDE = np.flatnonzero(ROD_X == 3.0)[0]


class Statement(NamedTuple):
    """One statement compared with both models."""

    where: str
    states: str
    fem: str
    exact: str
    agrees: bool | None  # by the exact solution; None where the paper gives nothing to compare with
    why: str


def statements() -> list[Statement]:
    """Every statement of the paper that its text defines."""
    fem, exact = quantities("fem"), quantities("layered")
    compared = []
    for where, states, name, form, bounds, why in TABLE:
        agrees = None if bounds is None else all(bounds[0] <= each <= bounds[1] for each in exact[name])
        numbers = form.format(*fem[name]), form.format(*exact[name])
        compared.append(Statement(where, states, *numbers, agrees, why))
    return compared


def quantities(model: Model) -> dict[str, tuple[float, ...]]:
    """What the statements are about, by one model; by the names in TABLE."""
    kernels = [covered(model, thickness) for thickness in models.THICKNESSES]
    peaks = [kernel.g[0] for kernel in kernels]
    rims = [abs(np.interp(20.0, kernel.r, kernel.g)) / kernel.g[0] for kernel in kernels]
    softest, *by_modulus = (covered(model, young=young).gain_at(Q) for young in (9.8, *models.MODULI))
    low, high = (covered(model, poisson=ratio).gain_at(Q) for ratio in (0.2, 0.45))
    rings = {thickness: under(kernel) for thickness, kernel in zip(models.THICKNESSES, kernels, strict=True)}
    sheets = [covered(model, sheet) for sheet in models.SHEETS]
    points, rods = (
        [cell_force(kernel, ROD_X, models.POINT) for kernel in each]
        for each in (sheets, [models.spread(sheet, models.ROD_CONTACT) for sheet in sheets])
    )
    values = {
        "exponent of the peak": np.polyfit(np.log(models.THICKNESSES), np.log(peaks), 1)[0],
        "stress at the rim": max(rims),
        "rise with modulus": max((stiffer - softer).max() for softer, stiffer in pairwise(by_modulus)),
        "gain of the softest": np.abs(softest - by_modulus[0]).max(),
        "change with Poisson's ratio": np.abs(high - low).max(),
        "corner over side": rings[0.2][CORNER] / rings[0.2][SIDE],
        "change by the rod": max(np.abs(rod - point).max() for rod, point in zip(rods, points, strict=True)),
    }
    values |= {f"G({q}, {t})": covered(model, t).gain_at(q) for q in (1, 2) for t in (0.1, 0.2, 0.4, 0.6, 1.0)}
    for thickness, ring in rings.items():
        values |= {f"peak {thickness}": ring.max(), f"hole {thickness}": ring[MIDDLE] / ring.max()}
    for young, poisson in ((490.0, 0.3), (4903.0, 0.3), (98.0, 0.45)):
        changed = under(covered(model, young=young, poisson=poisson))
        values[f"change {young:g}, {poisson}"] = np.abs(changed - rings[0.2]).max()
    return {name: (float(value),) for name, value in values.items()} | {
        "changes with Poisson's ratio": (float((high - low).min()), float((high - low).max())),
        "beside the rod": tuple(float(force[BESIDE]) for force in points),
    }


DIGIT = "To the one digit given."  # ±0.05
Bounds = tuple[float, float] | None  # of the exact numbers, if they agree
TABLE: tuple[tuple[str, str, str, str, Bounds, str], ...] = (
    ("III-B-1, Fig. 4", "The peak of g(r) falls in inverse proportion to the square of the thickness.",
     "exponent of the peak", "exponent {:.3f}", (-2.02, -1.98),
     "The power law through the four peaks."),
    ("III-A", "At the rim of a model 40 mm across the stress has become negligible.",
     "stress at the rim", "{:.0e} of peak", (0, 1e-6),
     "Largest stress at r = 20 mm under any of the four covers."),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.9 under 0.1 mm.", "G(1, 0.1)", "{:.3f}", (0.85, 0.95), DIGIT),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.8 under 0.2 mm.", "G(1, 0.2)", "{:.3f}", (0.75, 0.85), DIGIT),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.4 under 0.6 mm.", "G(1, 0.6)", "{:.3f}", (0.35, 0.45),
     "0.42 is the gain under 0.4 mm. A soft cover's gain depends almost on thickness times frequency alone, so "
     "the paper's own 0.4 at 2/mm under 0.2 mm means 0.4 at 1/mm under 0.4 mm, less under 0.6."),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.2 under 1.0 mm.", "G(1, 1.0)", "{:.3f}", (0.15, 0.25),
     "1.0 mm is not among the thicknesses that the paper computes (0.1, 0.2, 0.4, 0.6 mm). The number is that of "
     "0.6 mm, 0.17: this gain and the one before seem to be written under the wrong thickness."),
    ("III-B-1, Fig. 5", "At 2/mm the gain is nearly zero under 0.4 mm.", "G(2, 0.4)", "{:.3f}",
     (0, 0.1), "Under a tenth is read as nearly zero."),
    ("III-B-1, Fig. 5", "At 2/mm the gain is 0.4 under 0.2 mm.", "G(2, 0.2)", "{:.3f}", (0.35, 0.45), DIGIT),
    ("VI", "At 2/mm the gain under 0.2 mm becomes less than 0.4.", "G(2, 0.2)", "{:.3f}",
     (0, 0.4), "It is 0.4 to one digit, as section III-B-1 gives it, but not less."),
    ("III-B-2, Fig. 6", "The softer the cover, the better the gain.",
     "rise with modulus", "{:+.4f}", (-inf, 1e-3),
     "Largest rise of G, at any q up to 6/mm, from one modulus to the next stiffer one: invisible in a figure."),
    ("III-B-2, VI", "Softer than a tenth of the sensor's modulus gains little more.",
     "gain of the softest", "{:.3f}", (0, 0.05),
     "Largest difference of G between covers of a tenth and of a hundredth of the sensor's modulus."),
    ("III-B-3, Fig. 7, VI", "A higher Poisson's ratio is more favourable.",
     "changes with Poisson's ratio", "{:+.3f} to {:+.3f}", (0, inf),
     "From ratio 0.2 to 0.45: for the better above 1.5/mm only; below, for the worse, and more so."),
    ("III-B-3, Fig. 7, VI", "The difference made by Poisson's ratio is only slight.",
     "change with Poisson's ratio", "{:.3f}", (0, 0.1),
     "Largest difference of G between ratios 0.2 and 0.45; any other parameter makes a greater one."),
    ("IV, Fig. 8(d)", "Under 0.1 mm the pattern is close to the original.",
     "peak 0.1", "peak {:.2f}", (0.9, inf),
     "Highest pressure over that on the cover; the hole stays under a tenth of it."),
    ("IV, Fig. 8(c)", "Under 0.2 mm the corners are enhanced.",
     "corner over side", "{:.2f} × the side", (1, inf),
     "A corner has pressed neighbours on both its arms and stays higher than a side: the ring's geometry. The "
     "cover enhances nothing: its gain never exceeds 1."),
    ("IV, Fig. 8(d)", "Under 0.4 mm the peak is lower and the profile broader.",
     "peak 0.4", "peak {:.2f}", (0, 0.73), "Under 0.2 mm the peak is 0.73."),
    ("IV, Fig. 8(d)", "Under 0.6 mm the inner hole is dim.",
     "hole 0.6", "hole {:.2f} of peak", (0.9, inf),
     "Under 0.4 mm it is at 0.52, under 0.2 mm at 0.04 of the peak."),
    ("IV, Fig. 8(e)", "A modulus below the sensor's hardly changes it.",
     "change 490, 0.3", "change {:.2f}", (0, 0.2),
     "Largest change, over the pressure on the cover, from 98 MPa and 0.3 to 490 MPa and 0.3."),
    ("IV, Fig. 8(e)", "It differs greatly at 4903 MPa.",
     "change 4903, 0.3", "change {:.2f}", (0.2, inf),
     "Largest change, over the pressure on the cover, from 98 MPa and 0.3 to 4903 MPa and 0.3."),
    ("IV, Fig. 8(f)", "It differs slightly with Poisson's ratio.",
     "change 98, 0.45", "change {:.2f}", (0, 0.2),
     "Largest change, over the pressure on the cover, from 98 MPa and 0.3 to 98 MPa and 0.45."),
    ("V, Fig. 10", "Measured forces agree well with the anticipated ones.",
     "beside the rod", "{:.3f}, {:.3f}, {:.3f} N", None,
     "No measured number stands in the text. Given here is what to expect of a cell when the rod is 0.7 mm beside "
     "it, under 0.25, 0.5 and 1.0 mm. Silicone rubber is nearer 2 MPa, 0.49 than the 98 MPa, 0.3 assumed; it "
     "changes the gain under 1.0 mm by up to 0.06."),
    ("V, Fig. 10", "The rod's load is concentrated.", "change by the rod", "up to {:.3f} N", None,
     "The contact is not given. Hertz's on a deep cover of 98 MPa is 0.27 mm in radius, on a thin one less: that "
     "is the most by which it can change a force, near the edge of the cell."),
)  # fmt: skip
