"""The paper's statements on g(r) and G(q), section III."""

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from tactiled.study.paper import cases
from tactiled.study.paper.cases import Floats, Which, covered
from tactiled.study.paper.claims import BOTH, ROUNDING, Claim, told

Q = np.linspace(0.1, 6, 591)  # cycles/mm
UNSEEN = 1e-3  # a change of gain that no figure shows


def at(q: float, thickness: float = 0.2) -> Callable[[Which], float]:
    """Give what measures the gain at q (cycles/mm) under a cover of `thickness` (mm)."""
    return lambda which: float(covered(thickness).of(which).gain_at(q))


def response() -> Iterator[Claim]:
    """Fig. 4."""

    def slope(which: Which) -> float:
        peaks = [covered(thickness).of(which).g[0] for thickness in cases.THICKNESSES]
        return float(np.polyfit(np.log(cases.THICKNESSES), np.log(peaks), 1)[0])

    yield Claim(
        "III-B-1, Fig. 4",
        "The peak of g(r) falls in inverse proportion to the square of the thickness.",
        *told(slope, "exponent {:.3f}"),
        abs(slope("exact") + 2) < 0.02,
        "The power law through the four peaks.",
    )

    def rim(which: Which) -> float:
        kernels = [covered(thickness).of(which) for thickness in cases.THICKNESSES]
        return max(float(abs(np.interp(20.0, kernel.r, kernel.g)) / kernel.g[0]) for kernel in kernels)

    yield Claim(
        "III-A",
        "At the rim of a model 40 mm across the stress has become negligible.",
        *told(rim, "{:.0e} of peak"),
        rim("exact") < 1e-6,
        "Largest stress at r = 20 mm under any of the four covers.",
    )


def thickness() -> Iterator[Claim]:
    """Fig. 5."""
    digit = "To the one digit given."
    yield _stated(1.0, 0.1, 0.9, digit)
    yield _stated(1.0, 0.2, 0.8, digit)
    near, far = at(1, 0.4)("exact"), at(1, 0.6)("exact")
    yield _stated(
        1.0,
        0.6,
        0.4,
        f"{near:.2f} is the gain under 0.4 mm. A soft cover's gain depends almost on thickness times frequency "
        "alone, so the paper's own 0.4 at 2/mm under 0.2 mm means 0.4 at 1/mm under 0.4 mm, less under 0.6.",
    )
    yield _stated(
        1.0,
        1.0,
        0.2,
        "1.0 mm is not among the thicknesses that the paper computes (0.1, 0.2, 0.4, 0.6 mm). The number is that "
        f"of 0.6 mm, {far:.2f}: this gain and the one before seem to be written under the wrong thickness.",
    )
    yield Claim(
        "III-B-1, Fig. 5",
        "At 2/mm the gain is nearly zero under 0.4 mm.",
        *told(at(2, 0.4)),
        at(2, 0.4)("exact") < 0.1,
        "Under a tenth is read as nearly zero.",
    )
    yield _stated(2.0, 0.2, 0.4, digit)
    yield Claim(
        "VI",
        "At 2/mm the gain under 0.2 mm becomes less than 0.4.",
        *told(at(2)),
        at(2)("exact") < 0.4,
        "It is 0.4 to one digit, as section III-B-1 gives it, but not less.",
    )


def _stated(q: float, thickness: float, value: float, why: str) -> Claim:
    """Hold a gain that the paper gives to one digit against both models."""
    measure = at(q, thickness)
    agrees = abs(measure("exact") - value) <= ROUNDING
    states = f"At {q:g}/mm the gain is {value:g} under {thickness:.1f} mm."
    return Claim("III-B-1, Fig. 5", states, *told(measure), agrees, why)


def modulus() -> Iterator[Claim]:
    """Fig. 6."""

    def rise(which: Which) -> float:
        gains = [covered(young=young).of(which).gain_at(Q) for young in cases.MODULI]
        return max(float((stiffer - softer).max()) for softer, stiffer in pairwise(gains))

    yield Claim(
        "III-B-2, Fig. 6",
        "The softer the cover, the better the gain.",
        *told(rise, "{:+.4f}"),
        rise("exact") < UNSEEN,
        "Largest rise of G, at any q up to 6/mm, from one modulus to the next stiffer one: too small to be seen.",
    )

    def gained(which: Which) -> float:
        tenth, hundredth = (covered(young=young).of(which).gain_at(Q) for young in (98.0, 9.8))
        return float(np.abs(hundredth - tenth).max())

    yield Claim(
        "III-B-2, VI",
        "Softer than a tenth of the sensor's modulus gains little more.",
        *told(gained),
        gained("exact") < ROUNDING,
        "Largest difference of G between covers of a tenth and of a hundredth of the sensor's modulus.",
    )


def poisson() -> Iterator[Claim]:
    """Fig. 7."""

    def change(which: Which) -> Floats:
        low, high = (covered(poisson=ratio).of(which).gain_at(Q) for ratio in (0.2, 0.45))
        return high - low

    fem, exact = (f"{change(which).min():+.3f} to {change(which).max():+.3f}" for which in BOTH)
    cross = Q[np.flatnonzero(np.diff(np.sign(change("exact"))))[0]]
    yield Claim(
        "III-B-3, Fig. 7, VI",
        "A higher Poisson's ratio is more favourable.",
        fem,
        exact,
        bool(change("exact").min() >= 0),
        f"From ratio 0.2 to 0.45: for the better above {cross:.1f}/mm only; below, for the worse, and more so.",
    )

    def largest(which: Which) -> float:
        return float(np.abs(change(which)).max())

    yield Claim(
        "III-B-3, Fig. 7, VI",
        "The difference made by Poisson's ratio is only slight.",
        *told(largest),
        largest("exact") < 2 * ROUNDING,
        "Largest difference of G between ratios 0.2 and 0.45; any other parameter makes a greater one.",
    )
