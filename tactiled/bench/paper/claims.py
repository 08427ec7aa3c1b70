"""What the paper states, and what finite elements and the exact solution make of it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tactiled.bench.paper import cases
from tactiled.bench.paper.cases import Which, covered, under
from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack

ROUNDING = 0.05  # the paper gives its gains to one digit


@dataclass(frozen=True, slots=True)
class Claim:
    """One statement held against both models."""

    where: str
    states: str
    fem: str
    exact: str
    agrees: bool | None  # None where the paper gives nothing to hold against
    why: str


def claims() -> list[Claim]:
    """Check every statement of the paper that its text defines."""
    return [*_gains(), *_materials(), *_ring(), *_rod()]


def _both(measure: Callable[[Which], float], form: str = "{:.3f}") -> tuple[str, str, float]:
    """Measure finite elements and the exact solution; the last is the exact number."""
    exact = measure("exact")
    return form.format(measure("fem")), form.format(exact), exact


def _at(q: float, thickness: float = 0.2) -> Callable[[Which], float]:
    return lambda which: float(covered(thickness).of(which).gain_at(q))


def _gains() -> Iterator[Claim]:
    """Figs. 4 and 5, section III-B-1."""
    fem, exact, slope = _both(
        lambda which: _slope([_peak(t, which) for t in cases.THICKNESSES]), "thickness^{:.3f}"
    )
    yield Claim(
        "III-B-1, Fig. 4",
        "The peak of g(r) falls in inverse proportion to the square of the thickness.",
        fem,
        exact,
        abs(slope + 2) < 0.02,
        "Exponent of the power law through the four peaks.",
    )
    for stated, thickness in ((0.9, 0.1), (0.8, 0.2)):
        yield _stated(1.0, thickness, stated, "To the one digit given.")
    read = {t: float(covered(t).exact.gain_at(1.0)) for t in (0.4, 0.6)}
    slip = f"The exact gains at 1/mm are {read[0.4]:.2f} for 0.4 mm and {read[0.6]:.2f} for 0.6 mm: "
    yield _stated(
        1.0,
        0.6,
        0.4,
        slip + "the number given for 0.6 mm is that of 0.4 mm, and the paper's own law (gain by "
        "thickness times frequency) gives 0.6 mm at 1/mm the same gain as 0.2 mm at 3/mm, not as at 2/mm.",
    )
    yield _stated(
        1.0,
        1.0,
        0.2,
        "1.0 mm is not among the thicknesses that the paper computes (0.1, 0.2, 0.4, 0.6 mm). "
        + slip
        + "the number given for 1.0 mm is near that of 0.6 mm. Thicknesses and gains seem to have slipped.",
    )
    yield Claim(
        "III-B-1, Fig. 5",
        "At 2/mm the gain is nearly zero under 0.4 mm.",
        *_both(_at(2, 0.4))[:2],
        _at(2, 0.4)("exact") < 0.1,
        "Under a tenth is read as nearly zero.",
    )
    yield _stated(2.0, 0.2, 0.4, "To the one digit given.")
    yield Claim(
        "VI",
        "At 2/mm the gain under 0.2 mm becomes less than 0.4.",
        *_both(_at(2))[:2],
        _at(2)("exact") < 0.4,
        "0.4 to one digit, but not less than it.",
    )
    far = {which: max(_far(t, which) for t in cases.THICKNESSES) for which in ("fem", "exact")}
    yield Claim(
        "III-A",
        "At the rim of a model 40 mm across the stress has become negligible.",
        f"{far['fem']:.0e} of the peak",
        f"{far['exact']:.0e} of the peak",
        far["exact"] < 1e-6,
        "Largest stress at r = 20 mm under any of the four covers.",
    )


def _stated(q: float, thickness: float, value: float, why: str) -> Claim:
    """Hold a gain that the paper gives to one digit against both models."""
    fem, exact, number = _both(_at(q, thickness))
    return Claim(
        "III-B-1, Fig. 5",
        f"At {q:g}/mm the gain is {value:g} under {thickness:g} mm.",
        fem,
        exact,
        abs(number - value) <= ROUNDING,
        why,
    )


def _peak(thickness: float, which: Which) -> float:
    return float(covered(thickness).of(which).g[0])


def _far(thickness: float, which: Which) -> float:
    kernel = covered(thickness).of(which)
    return float(abs(np.interp(20.0, kernel.r, kernel.g)) / kernel.g[0])


def _slope(peaks: list[float]) -> float:
    return float(np.polyfit(np.log(cases.THICKNESSES), np.log(peaks), 1)[0])


def _materials() -> Iterator[Claim]:
    """Figs. 6 and 7, sections III-B-2 and III-B-3."""
    q = np.linspace(0.1, 6, 591)
    moduli = {which: [covered(young=young).of(which).gain_at(q) for young in cases.MODULI] for which in BOTH}
    rising = {
        which: max(float((b - a).max()) for a, b in zip(m, m[1:], strict=False)) for which, m in moduli.items()
    }
    yield Claim(
        "III-B-2, Fig. 6",
        "The softer the cover, the better the gain.",
        f"{rising['fem']:+.4f} at most",
        f"{rising['exact']:+.4f} at most",
        rising["exact"] <= 1e-6,
        "Largest change of G, at any q up to 6/mm, from one modulus to the next stiffer one.",
    )
    soft = {
        which: float(np.abs(moduli[which][0] - covered(young=9.8).of(which).gain_at(q)).max()) for which in BOTH
    }
    yield Claim(
        "III-B-2, VI",
        "Softer than a tenth of the sensor's modulus gains little more.",
        f"{soft['fem']:.3f}",
        f"{soft['exact']:.3f}",
        soft["exact"] < ROUNDING,
        "Largest difference of G between covers of a tenth and of a hundredth of the sensor's modulus.",
    )
    change = {w: covered(poisson=0.45).of(w).gain_at(q) - covered(poisson=0.2).of(w).gain_at(q) for w in BOTH}
    cross = {which: float(q[np.flatnonzero(np.diff(np.sign(change[which])))[0]]) for which in BOTH}
    span = [f"{change[w].min():+.3f} to {change[w].max():+.3f}, above 0 from {cross[w]:.2f}/mm" for w in BOTH]
    yield Claim(
        "III-B-3, Fig. 7, VI",
        "A higher Poisson's ratio is more favourable.",
        span[0],
        span[1],
        bool(change["exact"].min() >= 0),
        f"From ratio 0.2 to 0.45 the gain rises only above {cross['exact']:.2f}/mm; below it falls, and by more.",
    )
    size = {which: float(np.abs(change[which]).max()) for which in BOTH}
    yield Claim(
        "III-B-3, Fig. 7, VI",
        "The difference made by Poisson's ratio is only slight.",
        f"{size['fem']:.3f}",
        f"{size['exact']:.3f}",
        size["exact"] < 2 * ROUNDING,
        "Largest difference of G between ratios 0.2 and 0.45; slight beside that of any other parameter.",
    )


BOTH: tuple[Which, Which] = ("fem", "exact")
CORNER, SIDE, MIDDLE = (12, 12), (12, 20), (20, 20)  # elements on the ring's corner, on its side, in its hole


def _ring() -> Iterator[Claim]:
    """Fig. 8, section IV."""

    def hole(thickness: float) -> Callable[[Which], float]:
        return lambda which: float(
            under(covered(thickness), which)[MIDDLE] / under(covered(thickness), which).max()
        )

    def corner(which: Which) -> float:
        picture = under(covered(), which)
        return float(picture[CORNER] / picture[SIDE])

    def peak(thickness: float) -> Callable[[Which], float]:
        return lambda which: float(under(covered(thickness), which).max())

    yield Claim(
        "IV, Fig. 8(d)",
        "Under 0.1 mm the pattern is close to the original.",
        *_both(peak(0.1), "peak {:.2f}")[:2],
        peak(0.1)("exact") > 0.9 and hole(0.1)("exact") < 0.1,
        "Peak over the pressure on the cover; the hole stays under a tenth of it.",
    )
    fem, exact, ratio = _both(corner, "{:.2f} times the side")
    highest = max(float(covered(t).exact.gain.max()) for t in cases.THICKNESSES)
    yield Claim(
        "IV, Fig. 8(c)",
        "Under 0.2 mm the corners are enhanced.",
        fem,
        exact,
        ratio > 1,
        "A corner has pressed neighbours on two arms and so keeps more than a side does: the ring's geometry. "
        f"The cover enhances nothing: its gain never exceeds {highest:.3f}.",
    )
    yield Claim(
        "IV, Fig. 8(d)",
        "Under 0.4 mm the peak is lower and the profile broader.",
        *_both(peak(0.4), "peak {:.2f}")[:2],
        peak(0.4)("exact") < peak(0.2)("exact"),
        f"Under 0.2 mm the peak is {peak(0.2)('exact'):.2f}.",
    )
    yield Claim(
        "IV, Fig. 8(d)",
        "Under 0.6 mm the inner hole is dim.",
        *_both(hole(0.6), "hole at {:.2f} of the peak")[:2],
        hole(0.6)("exact") > 0.9,
        f"Under 0.4 mm it is at {hole(0.4)('exact'):.2f}, under 0.2 mm at {hole(0.2)('exact'):.2f}.",
    )
    yield _changed(
        "IV, Fig. 8(e)", "The pattern hardly changes with a modulus below the sensor's.", 490.0, 0.3, False
    )
    yield _changed("IV, Fig. 8(e)", "It differs greatly at 4903 MPa.", 4903.0, 0.3, True)
    yield _changed("IV, Fig. 8(f)", "It differs slightly with Poisson's ratio.", 98.0, 0.45, False)


def _changed(where: str, states: str, young: float, poisson: float, greatly: bool) -> Claim:
    """Measure the ring's largest change, over the pressure on the cover, from the reference cover."""

    def change(which: Which) -> float:
        return float(np.abs(under(covered(young=young, poisson=poisson), which) - under(covered(), which)).max())

    fem, exact, number = _both(change, "change {:.2f}")
    why = f"Largest change against 98 MPa and ratio 0.3, over the pressure on the cover ({young:g} MPa, {poisson:g})."
    return Claim(where, states, fem, exact, (number > 0.2) == greatly, why)


def _rod() -> Iterator[Claim]:
    """Fig. 10, section V."""
    x = np.linspace(0, 4, 81)
    force = {w: [cases.cell_force(covered(t).of(w), x, 0.02) for t in cases.SHEETS] for w in BOTH}
    inside, outside = x < 1.5, x > 3
    spread = {w: [float(f[outside][0]) for f in force[w]] for w in BOTH}
    real = Stack((Layer(1.0, 2.0, 0.49), cases.SENSOR))
    q = np.linspace(0.01, 2, 200)
    rubber = float(np.abs(gain(real, q) - gain(covered(1.0).exact.stack, q)).max())
    yield Claim(
        "V, Fig. 10",
        "Measured forces agree well with the anticipated ones.",
        *(", ".join(f"{value:.3f} N" for value in spread[w]) for w in BOTH),
        None,
        "The text gives no measured number. The anticipated force on a cell from a rod 0.8 mm outside it, under "
        f"0.25, 0.5 and 1.0 mm, is shown; within 1.5 mm of its middle it is above {_least(force['exact'], inside):.2f} "
        f"N of 0.98 N. The rod's contact, {cases.rod_contact(98.0, 0.3):.2f} mm in radius on a deep cover of 98 MPa "
        f"(Hertz), is taken for a point. Silicone rubber is nearer 2 MPa and 0.49: that changes G by up to "
        f"{rubber:.2f} under 1.0 mm.",
    )


def _least(forces: list[cases.Floats], chosen: np.ndarray) -> float:
    return min(float(force[chosen].min()) for force in forces)
