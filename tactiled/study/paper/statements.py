"""The paper's statements, each compared with both models."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack
from tactiled.study.paper import models
from tactiled.study.paper.models import Model, covered, under
from tactiled.study.scenes import Floats

Measure = Callable[[Model], float]

BOTH: tuple[Model, Model] = ("fem", "exact")
ROUNDING = 0.05  # the paper gives its gains to one digit
Q = np.linspace(0.1, 6, 591)  # cycles/mm
INVISIBLE = 1e-3  # a change of gain that no figure shows
GREAT = 0.2  # a great change of pressure, over that on the cover
CORNER, SIDE, MIDDLE = (12, 12), (12, 20), (20, 20)  # elements on the ring's corner, on its side, in its hole
SILICONE = Layer(1.0, 2.0, 0.49)
BESIDE = 3.0  # mm from the cell's middle to the rod


@dataclass(frozen=True, slots=True)
class Statement:
    """One statement compared with both models."""

    where: str
    states: str
    fem: str
    exact: str
    agrees: bool | None  # None where the paper gives nothing to compare with
    why: str


def statement(
    where: str, states: str, measure: Measure, form: str, agrees: Callable[[float], bool | None], why: str
) -> Statement:
    """Compare a statement with a number that both models give; the exact one decides."""
    fem, exact = measure("fem"), measure("exact")
    return Statement(where, states, form.format(fem), form.format(exact), agrees(exact), why)


def statements() -> list[Statement]:
    """Every statement of the paper that its text defines."""
    parts = (_response, _thickness, _modulus, _poisson, _ring, _materials, _rod)
    return [each for part in parts for each in part()]


def _gain(q: float, thickness: float = 0.2) -> Measure:
    """The gain at q (cycles/mm) under a cover of `thickness` (mm)."""
    return lambda model: float(covered(thickness).of(model).gain_at(q))


def _response() -> Iterator[Statement]:
    """Fig. 4."""

    def slope(model: Model) -> float:
        peaks = [covered(thickness).of(model).g[0] for thickness in models.THICKNESSES]
        return float(np.polyfit(np.log(models.THICKNESSES), np.log(peaks), 1)[0])

    def rim(model: Model) -> float:
        kernels = [covered(thickness).of(model) for thickness in models.THICKNESSES]
        return max(float(abs(np.interp(20.0, kernel.r, kernel.g)) / kernel.g[0]) for kernel in kernels)

    yield statement(
        "III-B-1, Fig. 4",
        "The peak of g(r) falls in inverse proportion to the square of the thickness.",
        slope,
        "exponent {:.3f}",
        lambda exponent: abs(exponent + 2) < 0.02,
        "The power law through the four peaks.",
    )
    yield statement(
        "III-A",
        "At the rim of a model 40 mm across the stress has become negligible.",
        rim,
        "{:.0e} of peak",
        lambda stress: stress < 1e-6,
        "Largest stress at r = 20 mm under any of the four covers.",
    )


def _thickness() -> Iterator[Statement]:
    """Fig. 5."""
    digit = "To the one digit given."
    yield _gain_is(1.0, 0.1, 0.9, digit)
    yield _gain_is(1.0, 0.2, 0.8, digit)
    yield _gain_is(
        1.0,
        0.6,
        0.4,
        f"{_gain(1, 0.4)('exact'):.2f} is the gain under 0.4 mm. A soft cover's gain depends almost on thickness "
        "times frequency alone, so the paper's own 0.4 at 2/mm under 0.2 mm means 0.4 at 1/mm under 0.4 mm, less "
        "under 0.6.",
    )
    yield _gain_is(
        1.0,
        1.0,
        0.2,
        "1.0 mm is not among the thicknesses that the paper computes (0.1, 0.2, 0.4, 0.6 mm). The number is that "
        f"of 0.6 mm, {_gain(1, 0.6)('exact'):.2f}: this and the gain before seem to stand at the wrong thickness.",
    )
    yield statement(
        "III-B-1, Fig. 5",
        "At 2/mm the gain is nearly zero under 0.4 mm.",
        _gain(2, 0.4),
        "{:.3f}",
        lambda exact: exact < 0.1,
        "Under a tenth is read as nearly zero.",
    )
    yield _gain_is(2.0, 0.2, 0.4, digit)
    yield statement(
        "VI",
        "At 2/mm the gain under 0.2 mm becomes less than 0.4.",
        _gain(2),
        "{:.3f}",
        lambda exact: exact < 0.4,
        "It is 0.4 to one digit, as section III-B-1 gives it, but not less.",
    )


def _gain_is(q: float, thickness: float, value: float, why: str) -> Statement:
    """Compare a gain that the paper gives to one digit."""
    states = f"At {q:g}/mm the gain is {value:g} under {thickness:.1f} mm."
    return statement(
        "III-B-1, Fig. 5",
        states,
        _gain(q, thickness),
        "{:.3f}",
        lambda exact: abs(exact - value) <= ROUNDING,
        why,
    )


def _modulus() -> Iterator[Statement]:
    """Fig. 6."""

    def rise(model: Model) -> float:
        gains = [covered(young=young).of(model).gain_at(Q) for young in models.MODULI]
        return max(float((stiffer - softer).max()) for softer, stiffer in pairwise(gains))

    def difference(model: Model) -> float:
        tenth, hundredth = (covered(young=young).of(model).gain_at(Q) for young in (98.0, 9.8))
        return float(np.abs(hundredth - tenth).max())

    yield statement(
        "III-B-2, Fig. 6",
        "The softer the cover, the better the gain.",
        rise,
        "{:+.4f}",
        lambda exact: exact < INVISIBLE,
        "Largest rise of G, at any q up to 6/mm, from one modulus to the next stiffer one: invisible in a figure.",
    )
    yield statement(
        "III-B-2, VI",
        "Softer than a tenth of the sensor's modulus gains little more.",
        difference,
        "{:.3f}",
        lambda exact: exact < ROUNDING,
        "Largest difference of G between covers of a tenth and of a hundredth of the sensor's modulus.",
    )


def _poisson() -> Iterator[Statement]:
    """Fig. 7."""

    def change(model: Model) -> Floats:
        low, high = (covered(poisson=ratio).of(model).gain_at(Q) for ratio in (0.2, 0.45))
        return high - low

    fem, exact = (f"{change(model).min():+.3f} to {change(model).max():+.3f}" for model in BOTH)
    cross = Q[np.flatnonzero(np.diff(np.sign(change("exact"))))[0]]
    yield Statement(
        "III-B-3, Fig. 7, VI",
        "A higher Poisson's ratio is more favourable.",
        fem,
        exact,
        bool(change("exact").min() >= 0),
        f"From ratio 0.2 to 0.45: for the better above {cross:.1f}/mm only; below, for the worse, and more so.",
    )
    yield statement(
        "III-B-3, Fig. 7, VI",
        "The difference made by Poisson's ratio is only slight.",
        lambda model: float(np.abs(change(model)).max()),
        "{:.3f}",
        lambda largest: largest < 2 * ROUNDING,
        "Largest difference of G between ratios 0.2 and 0.45; any other parameter makes a greater one.",
    )


def _peak(thickness: float) -> Measure:
    """The highest pressure under a cover of `thickness` (mm), over that on the cover."""
    return lambda model: float(under(covered(thickness), model).max())


def _hole(thickness: float) -> Measure:
    """The pressure in the ring's hole over the highest."""
    return lambda model: float(under(covered(thickness), model)[MIDDLE]) / _peak(thickness)(model)


def _ring() -> Iterator[Statement]:
    """Fig. 8, by thickness."""

    def corner(model: Model) -> float:
        picture = under(covered(), model)
        return float(picture[CORNER] / picture[SIDE])

    highest = max(float(covered(thickness).exact.gain.max()) for thickness in models.THICKNESSES)
    yield statement(
        "IV, Fig. 8(d)",
        "Under 0.1 mm the pattern is close to the original.",
        _peak(0.1),
        "peak {:.2f}",
        lambda peak: peak > 0.9 and _hole(0.1)("exact") < 0.1,
        "Highest pressure over that on the cover; the hole stays under a tenth of it.",
    )
    yield statement(
        "IV, Fig. 8(c)",
        "Under 0.2 mm the corners are enhanced.",
        corner,
        "{:.2f} × the side",
        lambda ratio: ratio > 1,
        "A corner has pressed neighbours on both its arms and stays higher than a side: the ring's geometry. "
        f"The cover enhances nothing: its gain never exceeds {highest:.3f}.",
    )
    yield statement(
        "IV, Fig. 8(d)",
        "Under 0.4 mm the peak is lower and the profile broader.",
        _peak(0.4),
        "peak {:.2f}",
        lambda peak: peak < _peak(0.2)("exact"),
        f"Under 0.2 mm the peak is {_peak(0.2)('exact'):.2f}.",
    )
    yield statement(
        "IV, Fig. 8(d)",
        "Under 0.6 mm the inner hole is dim.",
        _hole(0.6),
        "hole {:.2f} of peak",
        lambda hole: hole > 0.9,
        f"Under 0.4 mm it is at {_hole(0.4)('exact'):.2f}, under 0.2 mm at {_hole(0.2)('exact'):.2f} of the peak.",
    )


def _materials() -> Iterator[Statement]:
    """Fig. 8, by material."""
    yield _change_is("e", "A modulus below the sensor's hardly changes it.", 490.0, 0.3, False)
    yield _change_is("e", "It differs greatly at 4903 MPa.", 4903.0, 0.3, True)
    yield _change_is("f", "It differs slightly with Poisson's ratio.", 98.0, 0.45, False)


def _change_is(panel: str, states: str, young: float, poisson: float, great: bool) -> Statement:
    """Compare the ring's largest change from the reference cover, over the pressure on the cover."""

    def change(model: Model) -> float:
        return float(np.abs(under(covered(young=young, poisson=poisson), model) - under(covered(), model)).max())

    why = f"Largest change, over the pressure on the cover, from 98 MPa and 0.3 to {young:g} MPa and {poisson:g}."
    return statement(
        f"IV, Fig. 8({panel})", states, change, "change {:.2f}", lambda one: (one > GREAT) == great, why
    )


def _rod() -> Iterator[Statement]:
    """Fig. 10."""
    x = np.linspace(0, 4, 81)
    sheets = {model: [covered(thickness).of(model) for thickness in models.SHEETS] for model in BOTH}
    force = {model: np.array([models.cell_force(k, x, models.POINT) for k in sheets[model]]) for model in BOTH}
    fem, exact = (", ".join(f"{one:.3f}" for one in force[model][:, x == BESIDE].ravel()) for model in BOTH)
    q = np.linspace(0.01, 2, 200)
    rubber = np.abs(gain(Stack((SILICONE, models.SENSOR)), q) - sheets["exact"][-1].gain_at(q)).max()
    yield Statement(
        "V, Fig. 10",
        "Measured forces agree well with the anticipated ones.",
        f"{fem} N",
        f"{exact} N",
        None,
        "No measured number stands in the text. Given here is what to expect of a cell when the rod is "
        f"{BESIDE - models.CELL / 2:.1f} mm beside it, under 0.25, 0.5 and 1.0 mm. Silicone rubber is nearer "
        f"2 MPa, 0.49 than the 98 MPa, 0.3 assumed; it changes the gain under 1.0 mm by up to {rubber:.2f}.",
    )
    radius = models.rod_contact(98.0, 0.3)

    def change(model: Model) -> float:
        spread = [models.cell_force(models.spread(k, radius), x, models.POINT) for k in sheets[model]]
        return float(np.abs(spread - force[model]).max())

    yield statement(
        "V, Fig. 10",
        "The rod's load is concentrated.",
        change,
        "up to {:.3f} N",
        lambda _: None,
        f"The contact is not given. Hertz's on a deep cover of 98 MPa is {radius:.2f} mm in radius, on a thin one "
        "less: that is the most by which it can change a force, near the edge of the cell.",
    )
