"""Two-point discrimination: the smallest gap at which two indenters are told from one, raw and restored."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.stats import norm

from tactiled.restore.methods import make
from tactiled.study.charts import figure
from tactiled.study.skin import Floats, Frames, Skin
from tactiled.study.stability_chart import STYLES
from tactiled.study.truth import PEAK

METHODS = ("raw", "wiener", "rl", "nnls", "auto")
GAPS = (1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0, 3.25, 3.5, 4.0, 5.0)  # pitches between the two middles
SURE = 0.95  # of the time two are told apart, and one is called one
RADIUS = 0.4  # pitches, of an indenter
ACROSS = 0.5  # pitches around a middle within which its height is looked for
STEP = 0.02  # pitches, of the bound's derivatives


@dataclass(frozen=True, slots=True)
class Told:
    """How surely each gap is told apart by each method on one skin."""

    skin: str
    thickness: float
    noise: float
    shares: dict[str, tuple[float, ...]]  # of the trials, by gap
    bound: float  # pitches: nothing unbiased tells apart less

    def least(self, method: str) -> float:
        """The smallest gap from which on two are told apart often enough; infinite where none is."""
        found = np.inf
        for gap, share in zip(reversed(GAPS), reversed(self.shares[method]), strict=True):
            if share < SURE:
                break
            found = gap
        return float(found)


def measure(skin: Skin, noise: float, trials: int, seed: int) -> Told:
    """Press two indenters, and one of their total force, at random places and angles, and look for a dip."""
    random = np.random.default_rng([seed, 8])
    single = float(skin.surface.sense(_two(skin, (0.0, 0.0), (0.0, 0.0))).max())
    sigma = noise * single
    restorers = {name: make(name, skin.blur, sigma) for name in METHODS}
    shares: dict[str, list[float]] = {name: [] for name in METHODS}
    for gap in GAPS:
        dips: dict[str, list[tuple[float, float]]] = {name: [] for name in METHODS}
        for _ in range(trials):
            middle, angle = random.uniform(-1, 1, 2), random.uniform(0, np.pi)
            half = gap / 2 * np.array([np.cos(angle), np.sin(angle)])
            pairs = (middle - half, middle + half), (middle, middle)
            frames = [_frame(skin, *pair, sigma, random) for pair in pairs]
            for name, restorer in restorers.items():
                both = []
                for frame in frames:
                    restorer.reset()
                    both.append(dip(restorer(frame).image.astype(np.float64), middle, half))
                dips[name].append((both[0], both[1]))
        for name, pairs_ in dips.items():
            two, one = np.array(pairs_).T
            limit = max(float(np.quantile(one, SURE)), 0.0)
            shares[name].append(float(np.mean(two > limit)))
    told = {name: tuple(values) for name, values in shares.items()}
    return Told(skin.name, skin.thickness, noise, told, bound(skin, sigma))


def dip(image: Floats, middle: Floats, half: Floats) -> float:
    """How far the image sinks halfway between two places, over the lower of the heights at them."""
    centre = (np.array(image.shape)[::-1] - 1) / 2
    along = half / max(float(np.linalg.norm(half)), 1e-9)
    steps = np.linspace(-ACROSS, ACROSS, 11)

    def height(place: Floats) -> Floats:
        x, y = (centre + place)[:, None] + along[:, None] * steps
        return np.asarray(map_coordinates(image, [y, x], order=1, mode="nearest"))

    lower = float(min(height(middle - half).max(), height(middle + half).max()))
    return float((lower - height(middle).min()) / lower) if lower > 0 else -1.0


def bound(skin: Skin, sigma: float) -> float:
    """The gap that is `SURE` standard deviations of any unbiased estimate of it, on both sides, away from none.

    Cramer-Rao for two indenters of unknown places and forces, along a row of taxels.
    """
    reach = 2 * float(norm.ppf(SURE))
    low, high = 0.02, max(GAPS)
    while high - low > 0.01:
        gap = (low + high) / 2
        low, high = (low, gap) if gap > reach * _gap_deviation(skin, gap, sigma) else (gap, high)
    return high


def _gap_deviation(skin: Skin, gap: float, sigma: float) -> float:
    places = np.array([-gap / 2, 0.0, gap / 2, 0.0])

    def sensed(at: Floats, forces: tuple[float, float] = (1.0, 1.0)) -> Floats:
        return _sensed(skin, at[:2], forces[0]) + _sensed(skin, at[2:], forces[1])

    columns = [(sensed(places + STEP * e) - sensed(places - STEP * e)) / (2 * STEP) for e in np.eye(4)]
    columns += [sensed(places, (1.0, 0.0)), sensed(places, (0.0, 1.0))]
    J = np.stack(columns, axis=1) / sigma
    covariance = np.linalg.pinv(J.T @ J, rcond=1e-12)
    direction = np.array([-1.0, 0, 1, 0, 0, 0])
    return float(np.sqrt(direction @ covariance @ direction))


def _sensed(skin: Skin, place: Floats, force: float) -> Floats:
    return force / 2 * skin.surface.sense(_two(skin, tuple(place), tuple(place)))


def _frame(skin: Skin, a: Floats, b: Floats, sigma: float, random: np.random.Generator) -> Frames:
    clean = skin.surface.sense(_two(skin, tuple(a), tuple(b))).reshape(skin.array.frame_shape)
    return np.asarray(clean + random.normal(0, sigma, clean.shape), np.float32)


def _two(skin: Skin, a: tuple[float, ...], b: tuple[float, ...]) -> Floats:
    """Two smooth indenters of one force each, at places in pitches from the middle."""
    x, y = skin.surface.x / skin.array.pitch, skin.surface.y / skin.array.pitch
    return np.asarray(
        PEAK * np.sum([np.exp(-((x - p) ** 2 + (y - q) ** 2) / (2 * RADIUS**2)) for p, q in (a, b)], axis=0)
    )


def sweep(skins: list[Skin], noise: float, trials: int, seed: int) -> Iterator[Told]:
    """Measure every skin."""
    for skin in skins:
        yield measure(skin, noise, trials, seed)


def draw(path: Path, found: list[Told]) -> None:
    """Draw the least gap against thickness, and how surely each gap is told apart in the middle of them."""
    styles = STYLES | {"raw": ("raw image", "#777777", "X", "-")}
    with figure(path, 10, 4.2) as drawn:
        left, right = drawn.subplots(1, 2)
        at = np.arange(len(found))
        one = found[len(found) // 2]
        for name in METHODS:
            label, colour, mark, dashes = styles[name]
            look = {"color": colour, "marker": mark, "ls": dashes, "label": label}
            fill, size = ("white", 9) if name == "nnls" else (colour, 9 if name == "auto" else 5)
            left.plot(at, [told.least(name) for told in found], **look, mfc=fill, ms=size)
            right.plot(GAPS, [100 * share for share in one.shares[name]], **look, mfc=fill, ms=size)
        left.plot(
            at, [told.bound for told in found], color="#444444", ls=(0, (4, 3)), lw=1.2, label="Cramér-Rao bound"
        )
        left.set_xticks(at, [f"{told.thickness:g}" for told in found])
        left.set(title="Smallest gap told apart", xlabel="t/pitch", ylabel="gap (pitches)", ylim=(0, None))
        right.axhline(100 * SURE, color="#444444", lw=1, ls=(0, (4, 3)))
        right.axvline(one.bound, color="#444444", lw=1.2, ls=(0, (4, 3)))
        right.set(title=f"{one.skin}, noise {100 * one.noise:g} %", xlabel="gap (pitches)", ylim=(0, 104))
        right.set_ylabel("told apart (% of the trials)")
        drawn.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=6)
