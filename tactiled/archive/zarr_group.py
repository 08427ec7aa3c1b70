"""Exports as Zarr (format 3): a group of arrays that grow by chunks of frames."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import ZstdCodec

from tactiled.archive import arrays
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import Image, Message

CHUNK_BYTES = 4 << 20  # of the largest array, at most: 1024 frames of 32 x 32, 256 of 64 x 64
NO_DATA = {"f": np.nan, "i": -1, "u": 255, "T": ""}  # by kind of dtype: a lost chunk reads so, not as pressure 0


class ZarrWriter:
    """One group; its arrays have a chunk for every so many frames, the last one fewer."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._group = zarr.create_group(path)
        self._places = {"positions_mm": plan.array.positions, "cells_mm": plan.cells.positions}
        self._rows: list[arrays.Arrays] = []
        self._chunk = 0  # frames
        taxels = ("row", "column") if len(plan.array.frame_shape) == 2 else ("taxel",)
        cells = ("cell_row", "cell_column") if len(plan.blur.surface_shape) == 2 else ("cell",)
        self._dimensions: dict[str, tuple[str, ...]] = {
            "raw": taxels, "flags": taxels, "restored": cells, "shear": ("axis", *taxels), "loss": ("loss_kind",),
            "regions": ("region", "measure"),
        }  # fmt: skip

    def add_message(self, message: Message) -> None:
        """Take one message, before the image that it completes."""

    def add_image(self, image: Image, regions: Mapping[str, Measures]) -> None:
        """Append one frame, which is written with the others of its chunk."""
        row = arrays.row(image, regions)
        largest = max(each.nbytes for each in row.values())
        self._chunk = self._chunk or max(1, min(arrays.FRAMES_AT_ONCE, CHUNK_BYTES // largest))
        self._rows.append(row)
        if len(self._rows) == self._chunk:
            self._append()

    def _append(self) -> None:
        for name in self._rows[0] if self._rows else ():
            frames = np.stack([each[name] for each in self._rows])
            if name not in self._group:
                self._create(name, frames)
            array: Any = self._group[name]
            array.append(frames)
        self._rows.clear()

    def _create(self, name: str, frames: Any) -> None:
        """Make an array for frames such as these, as yet without one."""
        dtype: Any = np.dtypes.StringDType() if frames.dtype.kind == "U" else frames.dtype
        self._group.create_array(
            name,
            shape=(0, *frames.shape[1:]),
            chunks=(self._chunk, *frames.shape[1:]),
            dtype=dtype,
            fill_value=NO_DATA[dtype.kind],
            compressors=ZstdCodec(checksum=True),
            dimension_names=("time", *self._dimensions.get(name, ())),
            config={"write_empty_chunks": True},  # zarr leaves out chunks of the fill value alone
        )

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the rest; units are attributes of the arrays, `provenance` is one of the group."""
        self._append()
        for (name, places), of in zip(self._places.items(), ("taxel", "cell"), strict=True):
            self._group.create_array(name, data=places, dimension_names=(of, "axis"))
        for name, unit in provenance["units"].items():
            if name in self._group:
                self._group[name].attrs["units"] = unit
        self._group.attrs["provenance"] = dict(provenance)

    def close(self) -> None:
        """Let go of what is not written."""
        self._rows.clear()
