"""The paper's statements, each compared with both models."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tactiled.study.paper import models
from tactiled.study.paper.models import Model, covered, under

Values = tuple[float, ...]
Measure = Callable[[Model], Values]

ROUNDING = 0.05  # the paper gives its gains to one digit
Q = np.linspace(0.1, 6, 591)  # cycles/mm
INVISIBLE = 1e-3  # a change of gain that no figure shows
GREAT = 0.2  # a great change of pressure, over that on the cover
CORNER, SIDE, MIDDLE = (12, 12), (12, 20), (20, 20)  # elements on the ring's corner, on its side, in its hole
ROD_X = np.linspace(0, 4, 81)  # mm from the cell's middle to the rod
BESIDE = np.flatnonzero(ROD_X == 3.0)[0]


@dataclass(frozen=True, slots=True)
class Statement:
    """One statement compared with both models."""

    where: str
    states: str
    fem: str
    exact: str
    agrees: bool | None  # by the exact solution; None where the paper gives nothing to compare with
    why: str


def statements() -> list[Statement]:
    """Every statement of the paper that its text defines."""
    compared = []
    for where, states, measure, form, agrees, why in TABLE:
        fem, exact = measure("fem"), measure("layered")
        compared.append(
            Statement(where, states, form.format(*fem), form.format(*exact), agrees and agrees(*exact), why)
        )
    return compared


def _gain(q: float, thickness: float) -> Measure:
    """The gain at q (cycles/mm) under a cover of `thickness` (mm)."""
    return lambda model: (float(covered(model, thickness).gain_at(q)),)


def _near(value: float) -> Callable[[float], bool]:
    return lambda gain: abs(gain - value) <= ROUNDING


def _peak_exponent(model: Model) -> Values:
    """Exponent of the power law of g(0) over the thickness."""
    peaks = [covered(model, thickness).g[0] for thickness in models.THICKNESSES]
    return (float(np.polyfit(np.log(models.THICKNESSES), np.log(peaks), 1)[0]),)


def _rim_stress(model: Model) -> Values:
    kernels = [covered(model, thickness) for thickness in models.THICKNESSES]
    return (max(float(abs(np.interp(20.0, kernel.r, kernel.g)) / kernel.g[0]) for kernel in kernels),)


def _rise_with_modulus(model: Model) -> Values:
    gains = [covered(model, young=young).gain_at(Q) for young in models.MODULI]
    return (max(float((stiffer - softer).max()) for softer, stiffer in pairwise(gains)),)


def _softest(model: Model) -> Values:
    tenth, hundredth = (covered(model, young=young).gain_at(Q) for young in (98.0, 9.8))
    return (float(np.abs(hundredth - tenth).max()),)


def _poisson_range(model: Model) -> Values:
    """The smallest and largest change of the gain from ratio 0.2 to 0.45."""
    low, high = (covered(model, poisson=ratio).gain_at(Q) for ratio in (0.2, 0.45))
    return float((high - low).min()), float((high - low).max())


def _peak(thickness: float) -> Measure:
    """The highest pressure under a cover of `thickness` (mm), over that on the cover."""
    return lambda model: (float(under(covered(model, thickness)).max()),)


def _hole(thickness: float) -> Measure:
    """The pressure in the ring's hole over the highest."""
    return lambda model: (float(under(covered(model, thickness))[MIDDLE]) / _peak(thickness)(model)[0],)


def _corner(model: Model) -> Values:
    picture = under(covered(model))
    return (float(picture[CORNER] / picture[SIDE]),)


def _change(young: float, poisson: float) -> Measure:
    """The ring's largest change from the reference cover, over the pressure on the cover."""
    return lambda model: (
        float(np.abs(under(covered(model, young=young, poisson=poisson)) - under(covered(model))).max()),
    )


def _beside_the_rod(model: Model) -> Values:
    forces = (models.cell_force(covered(model, sheet), ROD_X, models.POINT) for sheet in models.SHEETS)
    return tuple(float(force[BESIDE]) for force in forces)


def _spread_rod(model: Model) -> Values:
    """Largest change of a force (N) by the rod's contact on a deep cover, instead of a point load."""
    radius = models.rod_contact(98.0, 0.3)
    kernels = [covered(model, sheet) for sheet in models.SHEETS]
    forces = [
        [models.cell_force(k, ROD_X, models.POINT) for k in (one, models.spread(one, radius))] for one in kernels
    ]
    return (max(float(np.abs(spread - point).max()) for point, spread in forces),)


DIGIT = "To the one digit given."
TABLE: tuple[tuple[str, str, Measure, str, Callable[..., bool] | None, str], ...] = (
    ("III-B-1, Fig. 4", "The peak of g(r) falls in inverse proportion to the square of the thickness.",
     _peak_exponent, "exponent {:.3f}", lambda exponent: abs(exponent + 2) < 0.02,
     "The power law through the four peaks."),
    ("III-A", "At the rim of a model 40 mm across the stress has become negligible.",
     _rim_stress, "{:.0e} of peak", lambda stress: stress < 1e-6,
     "Largest stress at r = 20 mm under any of the four covers."),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.9 under 0.1 mm.", _gain(1, 0.1), "{:.3f}", _near(0.9), DIGIT),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.8 under 0.2 mm.", _gain(1, 0.2), "{:.3f}", _near(0.8), DIGIT),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.4 under 0.6 mm.", _gain(1, 0.6), "{:.3f}", _near(0.4),
     "0.42 is the gain under 0.4 mm. A soft cover's gain depends almost on thickness times frequency alone, so "
     "the paper's own 0.4 at 2/mm under 0.2 mm means 0.4 at 1/mm under 0.4 mm, less under 0.6."),
    ("III-B-1, Fig. 5", "At 1/mm the gain is 0.2 under 1.0 mm.", _gain(1, 1.0), "{:.3f}", _near(0.2),
     "1.0 mm is not among the thicknesses that the paper computes (0.1, 0.2, 0.4, 0.6 mm). The number is that of "
     "0.6 mm, 0.17: this gain and the one before seem to be written under the wrong thickness."),
    ("III-B-1, Fig. 5", "At 2/mm the gain is nearly zero under 0.4 mm.", _gain(2, 0.4), "{:.3f}",
     lambda gain: gain < 0.1, "Under a tenth is read as nearly zero."),
    ("III-B-1, Fig. 5", "At 2/mm the gain is 0.4 under 0.2 mm.", _gain(2, 0.2), "{:.3f}", _near(0.4), DIGIT),
    ("VI", "At 2/mm the gain under 0.2 mm becomes less than 0.4.", _gain(2, 0.2), "{:.3f}",
     lambda gain: gain < 0.4, "It is 0.4 to one digit, as section III-B-1 gives it, but not less."),
    ("III-B-2, Fig. 6", "The softer the cover, the better the gain.",
     _rise_with_modulus, "{:+.4f}", lambda rise: rise < INVISIBLE,
     "Largest rise of G, at any q up to 6/mm, from one modulus to the next stiffer one: invisible in a figure."),
    ("III-B-2, VI", "Softer than a tenth of the sensor's modulus gains little more.",
     _softest, "{:.3f}", lambda difference: difference < ROUNDING,
     "Largest difference of G between covers of a tenth and of a hundredth of the sensor's modulus."),
    ("III-B-3, Fig. 7, VI", "A higher Poisson's ratio is more favourable.",
     _poisson_range, "{:+.3f} to {:+.3f}", lambda low, _: low >= 0,
     "From ratio 0.2 to 0.45: for the better above 1.5/mm only; below, for the worse, and more so."),
    ("III-B-3, Fig. 7, VI", "The difference made by Poisson's ratio is only slight.",
     lambda model: (max(map(abs, _poisson_range(model))),), "{:.3f}", lambda change: change < 2 * ROUNDING,
     "Largest difference of G between ratios 0.2 and 0.45; any other parameter makes a greater one."),
    ("IV, Fig. 8(d)", "Under 0.1 mm the pattern is close to the original.",
     _peak(0.1), "peak {:.2f}", lambda peak: peak > 0.9 and _hole(0.1)("layered")[0] < 0.1,
     "Highest pressure over that on the cover; the hole stays under a tenth of it."),
    ("IV, Fig. 8(c)", "Under 0.2 mm the corners are enhanced.",
     _corner, "{:.2f} × the side", lambda ratio: ratio > 1,
     "A corner has pressed neighbours on both its arms and stays higher than a side: the ring's geometry. The "
     "cover enhances nothing: its gain never exceeds 1."),
    ("IV, Fig. 8(d)", "Under 0.4 mm the peak is lower and the profile broader.",
     _peak(0.4), "peak {:.2f}", lambda peak: peak < _peak(0.2)("layered")[0], "Under 0.2 mm the peak is 0.73."),
    ("IV, Fig. 8(d)", "Under 0.6 mm the inner hole is dim.",
     _hole(0.6), "hole {:.2f} of peak", lambda hole: hole > 0.9,
     "Under 0.4 mm it is at 0.52, under 0.2 mm at 0.04 of the peak."),
    ("IV, Fig. 8(e)", "A modulus below the sensor's hardly changes it.",
     _change(490.0, 0.3), "change {:.2f}", lambda change: change <= GREAT,
     "Largest change, over the pressure on the cover, from 98 MPa and 0.3 to 490 MPa and 0.3."),
    ("IV, Fig. 8(e)", "It differs greatly at 4903 MPa.",
     _change(4903.0, 0.3), "change {:.2f}", lambda change: change > GREAT,
     "Largest change, over the pressure on the cover, from 98 MPa and 0.3 to 4903 MPa and 0.3."),
    ("IV, Fig. 8(f)", "It differs slightly with Poisson's ratio.",
     _change(98.0, 0.45), "change {:.2f}", lambda change: change <= GREAT,
     "Largest change, over the pressure on the cover, from 98 MPa and 0.3 to 98 MPa and 0.45."),
    ("V, Fig. 10", "Measured forces agree well with the anticipated ones.",
     _beside_the_rod, "{:.3f}, {:.3f}, {:.3f} N", None,
     "No measured number stands in the text. Given here is what to expect of a cell when the rod is 0.7 mm beside "
     "it, under 0.25, 0.5 and 1.0 mm. Silicone rubber is nearer 2 MPa, 0.49 than the 98 MPa, 0.3 assumed; it "
     "changes the gain under 1.0 mm by up to 0.06."),
    ("V, Fig. 10", "The rod's load is concentrated.", _spread_rod, "up to {:.3f} N", None,
     "The contact is not given. Hertz's on a deep cover of 98 MPa is 0.27 mm in radius, on a thin one less: that "
     "is the most by which it can change a force, near the edge of the cell."),
)  # fmt: skip
