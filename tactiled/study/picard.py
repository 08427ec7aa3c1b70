"""What an array under a cover can know at all: its singular values against the noise, and Picard's plot."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.study.charts import COLOURS, figure
from tactiled.study.skin import Floats, Skin, drawn, means, pressed
from tactiled.study.truth import DRAWN

BLUE, RED, GREEN = COLOURS[:3]
BLOCKS = 40  # that modes are averaged in, for the eye


@dataclass(frozen=True, slots=True, eq=False)
class Picard:
    """A scene's modes, strongest first; kPa."""

    skin: str
    cell_mm: float
    scene: str
    sigma: float  # of a taxel
    singular: Floats  # of the blur
    frequency: Floats  # cycles a cell
    truth: Floats  # |v' x|, of the scene on the surface
    seen: Floats  # |u' y|, of the noisy frame

    @property
    def clear(self) -> int:
        """How many modes of this scene are above the noise, up to the first run of them that is not."""
        above = _smooth(self.singular * self.truth) > self.sigma
        return int(above.size if above.all() else np.argmin(above))

    @property
    def resolution_mm(self) -> float:
        """Half-period of the finest mode among those."""
        finest = float(self.frequency[: self.clear].max(initial=0.0))
        return 0.5 * self.cell_mm / finest if finest else float("inf")


def measure(skin: Skin, noise: float, seed: int, scene: str = "punches") -> Picard:
    """Look at a scene, or the first that touches the skin, with white noise of `noise` of the peak."""
    images = ((name, drawn(skin, name, seed)) for name in (scene, *DRAWN))
    scene, fine = next((name, each) for name, each in images if pressed(means(skin, each)[None]))
    clean = skin.surface.sense(fine).reshape(skin.array.frame_shape)
    sigma = noise * float(clean.max())
    frame = clean + np.random.default_rng([seed, 7]).normal(0, sigma, clean.shape)
    modes = skin.blur.modes
    seen, truth = _into(modes.taxel, frame), _into(modes.surface, means(skin, fine))[modes.head]
    order = np.argsort(-modes.gain, axis=None)
    return Picard(
        skin=skin.name,
        cell_mm=skin.blur.cell_mm,
        scene=scene,
        sigma=sigma,
        singular=np.abs(modes.gain).ravel()[order],
        frequency=modes.frequency[modes.head].ravel()[order],
        truth=np.abs(truth).ravel()[order],
        seen=np.abs(seen).ravel()[order],
    )


def _into(bases: tuple[Floats, ...], image: Floats) -> Floats:
    first = bases[0].T @ image
    return np.asarray(first if len(bases) == 1 else first @ bases[1])


def _smooth(values: Floats) -> Floats:
    """Root mean square over a window that widens with the mode's number."""
    power = np.concatenate([[0.0], np.cumsum(values**2)])
    n = np.arange(values.size)
    half = np.maximum(1, n // 12)
    low, high = np.maximum(n - half, 0), np.minimum(n + half + 1, values.size)
    return np.asarray(np.sqrt((power[high] - power[low]) / (high - low)))


def draw(path: Path, found: list[Picard]) -> None:
    """Draw the singular values of every skin, and the first one's Picard plot."""
    with figure(path, 10, 4.2) as drawn_:
        left, right = drawn_.subplots(1, 2)
        for one, colour in zip(found, COLOURS, strict=False):
            left.plot(1 + np.arange(one.singular.size), one.singular, color=colour, label=one.skin)
            left.plot(max(one.clear, 1), one.singular[max(one.clear, 1) - 1], "o", color=colour, ms=7)
        left.set(title="Singular values", xlabel="mode, strongest first", ylabel="what the cover lets through")
        left.set(xscale="log", yscale="log", ylim=(1e-5, 2))
        left.plot([], [], "o", color="#666666", ms=7, label=f"the last that shows {found[0].scene}")
        left.legend(loc="lower left")
        one = found[len(found) // 2]
        number = 1 + np.arange(one.singular.size)
        right.plot(number, one.seen, ".", color="#bbbbbb", ms=3, zorder=1)
        right.plot(number, _smooth(one.seen), color=BLUE, label="in the frame, |u′y|")
        right.plot(
            number, _smooth(one.singular * one.truth), color=GREEN, ls=(0, (4, 2)), label="without noise, s |v′x|"
        )
        right.plot(number, _smooth(one.seen) / one.singular, color=RED, label="inverted, |u′y| / s")
        right.axhline(one.sigma, color="#444444", lw=1)
        right.text(1.2, one.sigma * 0.8, "noise of a taxel", fontsize=9, va="top")
        right.axvspan(max(one.clear, 1), number[-1], color="#FBEEE6", lw=0, zorder=0)
        right.text(number[-1] * 0.9, 4e3 * one.sigma, "under the noise", ha="right", fontsize=9, color="#7d3600")
        right.set(xscale="log", yscale="log", xlim=(1, number[-1]), ylim=(one.sigma / 10, 1e4 * one.sigma))
        right.set(title=f"Picard's plot: {one.skin}, {one.scene}", xlabel="mode, strongest first")
        right.set_ylabel("size of the mode (kPa)")
        right.legend(loc="upper left", fontsize=9)
