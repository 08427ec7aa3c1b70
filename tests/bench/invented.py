"""Detail finer than the resolution that an image states: how much of it there is, and how much of it is right."""

from collections import defaultdict
from typing import Annotated

import numpy as np
import typer
from scipy.fft import dctn

from tactiled.cli.bench import print_table
from tactiled.restore.methods import make
from tests.bench.judge import NOISES, THICKNESSES
from tests.bench.presses import FAMILIES, presses

HEADINGS = ("", "noise", "in the truth", "in the image", "error of it", "images with more than the truth")


def finer(image, resolution):
    """Coefficients of an image's cosines whose half-period is below a resolution in cells; 0 for all others."""
    rows, columns = (np.arange(n) / n for n in image.shape)  # over twice the half-period of a cell
    coefficients = dctn(np.asarray(image, float), norm="ortho")
    return coefficients * (np.hypot(rows[:, None], columns) > 1 / resolution)


def details(press, method):
    """Norms over the truth's: of the truth's own finer detail, of the image's, and of their difference."""
    done = make(method, press.blur, press.sigma)(press.frame)
    resolution = done.resolution_mm / press.blur.cell_mm
    truth, image = (finer(each, resolution) for each in (press.truth, done.image))
    return [np.linalg.norm(each) / np.linalg.norm(press.truth) for each in (truth, image, image - truth)]


def invented(
    size: Annotated[int, typer.Option(help="Taxels along each side.")] = 32,
    repeats: Annotated[int, typer.Option(help="Presses of each scene, t/pitch and noise.")] = 2,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    methods: Annotated[str, typer.Option(help="Of ours, by commas.")] = "learned,tv,nnls,wiener",
) -> None:
    """Measure detail finer than `resolution_mm`, in the truth and in the image, on the second family of scenes.

    An error below the truth's own means that the detail in the image is right more often than not.
    """
    norms = defaultdict(list)
    for press in presses(size, THICKNESSES, NOISES, repeats, seed, FAMILIES["second"]):
        for method in methods.split(","):
            norms[method, press.noise].append(details(press, method))
    rows = []
    for (method, noise), each in sorted(norms.items(), key=lambda item: (item[0][1], item[0][0])):
        truth, image, error = np.mean(each, axis=0)
        more = np.mean([b > a for a, b, _ in each])
        rows.append((method, f"{noise:.1%}", f"{truth:.3f}", f"{image:.3f}", f"{error:.3f}", f"{more:.0%}"))
    print_table("Detail finer than the stated resolution, over the norm of the truth", HEADINGS, rows)
