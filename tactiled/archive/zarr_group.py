"""Exports as Zarr (format 3): a group of arrays that grow by chunks of frames."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import ZstdCodec

from tactiled.archive import arrays
from tactiled.archive.writers import Writer
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import SensorImage

NO_DATA = {"f": np.nan, "i": -1, "u": 255, "T": ""}  # by kind of dtype: a lost chunk reads so, not as pressure 0
LOCAL = "Consolidated metadata is currently not part"  # of Zarr 3, says zarr: others ignore it


class ZarrWriter(Writer):
    """One group; its arrays have a chunk for every so many frames, the last one fewer."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._group = zarr.create_group(path)
        self._plan = plan
        self._chunk = arrays.Chunk()
        self._dimensions = arrays.dimensions(plan)
        self.close = self._chunk.take

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Append one frame, which is written with the others of its chunk."""
        if self._chunk.add(arrays.row(image, regions, self._plan)):
            self._append()

    def _append(self) -> None:
        for name, frames in self._chunk.take().items():
            if name not in self._group:
                self._create(name, frames)
            array: Any = self._group[name]
            array.append(frames)

    def _create(self, name: str, frames: Any) -> None:
        """Make an array for frames such as these, as yet without one."""
        dtype: Any = np.dtypes.StringDType() if frames.dtype.kind == "U" else frames.dtype
        self._group.create_array(
            name,
            shape=(0, *frames.shape[1:]),
            chunks=(self._chunk.frames, *frames.shape[1:]),
            dtype=dtype,
            fill_value=NO_DATA[dtype.kind],
            compressors=ZstdCodec(checksum=True),
            dimension_names=self._dimensions.get(name, ("time",)),
            config={"write_empty_chunks": True},  # zarr leaves out chunks of the fill value alone
        )

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the rest; units are attributes of the arrays, `provenance` is one of the group."""
        self._append()
        for name, values in arrays.frameless(self._plan, provenance).items():
            data = values.astype(np.dtypes.StringDType()) if values.dtype.kind == "U" else values
            self._group.create_array(name, data=data, dimension_names=self._dimensions[name])
        for name, array in self._group.arrays():
            about = arrays.attributes(name, provenance)
            array.update_attributes({key: np.array(each).tolist() for key, each in about.items()})
        self._group.update_attributes({"provenance": dict(provenance)})
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", LOCAL)
            zarr.consolidate_metadata(self._group.store)
