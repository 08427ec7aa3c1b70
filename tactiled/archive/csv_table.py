"""Exports as CSV: a line a frame, a column a number with its unit in its heading; empty: not known."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.archive.arrays import LOSS_KINDS, loads
from tactiled.archive.writers import Writer
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures, headings
from tactiled.frames import SensorImage
from tactiled.units import PRESSURE, SHEAR


def values(numbers: Iterable[float]) -> list[str]:
    """Values of a region as a CSV has them."""
    return ["" if each != each else f"{each:.6g}" for each in numbers]


class CsvWriter(Writer):
    """One CSV file, written as images come; it has no provenance."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._file = path.open("w", newline="", encoding="utf-8")
        self._lines = csv.writer(self._file, lineterminator="\n")
        self._plan, self._unit = plan, plan.unit
        self._empty = True
        self.close = self._file.close

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Append one frame."""
        arrays: dict[str, NDArray[Any]] = {
            f"raw_{self._unit}": image.raw,
            f"restored_{self._unit}": image.restored,
            "flags": image.flags,
        }
        for axis, shear in zip("xy", () if image.shear is None else image.shear, strict=False):
            arrays[f"shear_{axis}_{SHEAR}"] = shear
        for name, both in loads(image, self._plan).items():
            arrays |= {f"{name}_{axis}_{PRESSURE}": each for axis, each in zip("xy", both, strict=True)}
        if self._empty:
            self._lines.writerow(self._headings(arrays, regions))
            self._empty = False
        of_regions = [each for measures in regions.values() for each in values(measures)]
        cells = [each for array in arrays.values() for each in _texts(array)]
        first = [f"{image.time:.6f}", image.sequence, image.method, f"{image.noise:.6g}"]
        self._lines.writerow([*first, *astuple(image.loss), *of_regions, *cells])

    def _headings(self, arrays: Mapping[str, NDArray[Any]], regions: Iterable[str]) -> list[str]:
        first = ["time_s", "sequence", "method", f"noise_{self._unit}", *(f"loss_{each}" for each in LOSS_KINDS)]
        of_regions = [f"{name}_{each}" for name in regions for each in headings(self._unit)]
        return [*first, *of_regions, *(each for name, array in arrays.items() for each in _cells(name, array))]

    def finish(self, _: Mapping[str, Any]) -> None:
        """Write the rest."""
        self._file.close()


def _cells(name: str, array: NDArray[Any]) -> list[str]:
    """Headings of an array: its name, and row and column, which count from 0."""
    return ["_".join(map(str, (name, *at))) for at in np.ndindex(array.shape)]


def _texts(array: NDArray[Any]) -> list[str]:
    """Shortest decimals that give the same numbers again."""
    return ["" if each == "nan" else each for each in array.ravel().astype(str).tolist()]
