"""The detail that an array under a cover can resolve: its singular values against the noise, and Picard's plot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.arrays import Floats
from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import Skin, draw, into, rubber, sense, touches
from tactiled.charts.style import BLUE, COLOURS, GREEN, RED, WORSE_COLOUR, figure

SCENE = "punches"
RUBBERS = (0.5, 1.0, 2.0, 3.0)  # t/pitch, where no skin is given


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
    frame: Floats  # |u' y|, of the noisy frame

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


def measure(skins: Sequence[Skin], noise: float, seed: int) -> list[Picard]:
    """Analyse every skin, or rubber if there is none, with white noise of `noise` of the peak."""
    return [analyse(skin, noise, seed) for skin in skins or [rubber(thickness, 32) for thickness in RUBBERS]]


def analyse(skin: Skin, noise: float, seed: int) -> Picard:
    """Analyse SCENE, or the first that touches the skin, with white noise of `noise` of the peak."""
    scenes = ((name, *sense(skin, draw(skin, name, [seed, 0]))) for name in (SCENE, *TEST_SCENES))
    scene, clean, cells = next(each for each in scenes if touches(each[2]))
    sigma = noise * float(clean.max())
    noisy = clean + np.random.default_rng([seed, 7]).normal(0, sigma, clean.shape)
    modes = skin.blur.modes
    frame, truth = into(modes.taxel, noisy), into(modes.surface, cells)[modes.head]
    order = np.argsort(-modes.gain, axis=None)
    return Picard(
        skin=skin.name,
        cell_mm=skin.blur.cell_mm,
        scene=scene,
        sigma=sigma,
        singular=np.abs(modes.gain).ravel()[order],
        frequency=modes.frequency[modes.head].ravel()[order],
        truth=np.abs(truth).ravel()[order],
        frame=np.abs(frame).ravel()[order],
    )


def _smooth(values: Floats) -> Floats:
    """Root mean square over a window that widens with the mode's number."""
    power = np.concatenate([[0.0], np.cumsum(values**2)])
    n = np.arange(values.size)
    half = np.maximum(1, n // 12)
    low, high = np.maximum(n - half, 0), np.minimum(n + half + 1, values.size)
    return np.asarray(np.sqrt((power[high] - power[low]) / (high - low)))


def write(folder: Path, measured: list[Picard]) -> None:
    """Draw picard.svg: the singular values of every skin, and the Picard plot of the one in the middle."""
    with figure(folder / "picard.svg", 10, 4.2) as drawing:
        values, plot = drawing.subplots(1, 2)
        for one, colour in zip(measured, COLOURS, strict=False):
            values.plot(1 + np.arange(one.singular.size), one.singular, color=colour, label=one.skin)
            values.plot(max(one.clear, 1), one.singular[max(one.clear, 1) - 1], "o", color=colour, ms=7)
        values.set(title="Singular values", xlabel="mode, strongest first", ylabel="what the cover lets through")
        values.set(xscale="log", yscale="log", ylim=(1e-5, 2))
        values.plot([], [], "o", color="#666666", ms=7, label=f"the last that shows {measured[0].scene}")
        values.legend(loc="lower left")
        one = measured[len(measured) // 2]
        number = 1 + np.arange(one.singular.size)
        clean = _smooth(one.singular * one.truth)
        plot.plot(number, one.frame, ".", color="#bbbbbb", ms=3, zorder=1)
        plot.plot(number, _smooth(one.frame), color=BLUE, label="in the frame, |u′y|")
        plot.plot(number, clean, color=GREEN, ls=(0, (4, 2)), label="without noise, s |v′x|")
        plot.plot(number, _smooth(one.frame) / one.singular, color=RED, label="inverted, |u′y| / s")
        plot.axhline(one.sigma, color="#444444", lw=1)
        plot.text(1.2, one.sigma * 0.8, "noise of a taxel", fontsize=9, va="top")
        plot.axvspan(max(one.clear, 1), number[-1], color=WORSE_COLOUR, lw=0, zorder=0)
        plot.text(number[-1] * 0.9, 4e3 * one.sigma, "under the noise", ha="right", fontsize=9, color="#7d3600")
        plot.set(xscale="log", yscale="log", xlim=(1, number[-1]), ylim=(one.sigma / 10, 1e4 * one.sigma))
        plot.set(title=f"Picard's plot: {one.skin}, {one.scene}", xlabel="mode, strongest first")
        plot.set_ylabel("size of the mode (kPa)")
        plot.legend(loc="upper left", fontsize=9)
