"""Exports as Parquet: a row a frame; images are lists, loss counts and regions have columns of their own."""

import json
from collections.abc import Iterator, Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from tactiled.archive import arrays
from tactiled.archive.writers import Writer
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures, headings
from tactiled.frames import SensorImage


class ParquetWriter(Writer):
    """One Parquet file, written by row groups of some MB."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._plan = plan
        self._chunk = arrays.Chunk()
        self._regions: tuple[str, ...] = ()
        self._shapes: dict[str, tuple[int, ...]] = {}  # of the images
        self._file = path.open("wb")
        self._table: Any = None  # under way from the first row group on
        self.close = self._file.close

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Append one frame, which is written with the others of its row group."""
        self._regions = (*regions,)
        if self._chunk.add(arrays.row(image, regions, self._plan)):
            self._append()

    def _append(self) -> None:
        if not (frames := self._chunk.take()):
            return
        frames.pop("noise_kpa", None)  # is `noise`
        frames[f"noise_{self._plan.unit}"] = frames.pop("noise")  # as a CSV names it
        images_last = sorted(frames.items(), key=lambda each: each[1].ndim)
        group = pa.table(dict(each for name, array in images_last for each in self._columns(name, array)))
        if self._table is None:
            self._table = parquet.ParquetWriter(self._file, group.schema)
        self._table.write_table(group)

    def _columns(self, name: str, array: NDArray[Any]) -> Iterator[tuple[str, Any]]:
        """The columns of an array of frames; NaN, not known, is null."""
        if name == "time":
            yield name, pa.array((array * 1e6).round().astype("M8[us]"), pa.timestamp("us", "UTC"))
        elif name == "loss":
            yield from (
                (f"loss_{kind}", pa.array(of)) for kind, of in zip(arrays.LOSS_KINDS, array.T, strict=True)
            )
        elif name == "regions":
            for region, measures in zip(self._regions, np.moveaxis(array, 1, 0), strict=True):
                for heading, of in zip(headings(self._plan.unit), measures.T, strict=True):
                    yield f"{region}_{heading}", pa.array(of, from_pandas=True)
        elif array.ndim == 1:
            yield name, pa.array(array, from_pandas=True)
        else:
            self._shapes[name] = array.shape[1:]
            numbers = pa.array(array.ravel(), from_pandas=True)
            yield name, pa.FixedSizeListArray.from_arrays(numbers, prod(array.shape[1:]))

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the rest; provenance, shapes of the images and positions are metadata of the file, as JSON."""
        self._append()
        places = {"positions_mm": self._plan.array.positions, "cells_mm": self._plan.cells.positions}
        about = {"provenance": provenance, "shapes": self._shapes}
        about |= {name: array.tolist() for name, array in places.items()}
        self._table.add_key_value_metadata({name: json.dumps(each) for name, each in about.items()})
        self._table.close()
        self._file.close()
