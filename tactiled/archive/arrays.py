"""Exports as files of arrays: .npz and HDF5. Arrays grow on the disk, so that a long recording takes no memory."""

import io
import json
import zipfile
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tactiled.archive.writers import Writer
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import Loss, SensorImage
from tactiled.units import PRESSURE

Arrays = dict[str, NDArray[Any]]
Attributes = dict[str, Any]
LOSS_KINDS = tuple(each.name for each in fields(Loss))
METHOD_NAME = "<U16"  # longer than any method's name
FRAMES_AT_ONCE = 1024  # that are copied to HDF5, or stand in one chunk of Zarr or row group of Parquet
CHUNK_BYTES = 4 << 20  # of a chunk's largest array, at most: 1024 frames of 32 x 32, 256 of 64 x 64
LABELS = {"loss_kind": "loss_kinds", "region": "regions", "measure": "region_measures"}  # keys of provenance
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable.{:10d}"  # netCDF's name of such a scale


class NpzWriter(Writer):
    """numpy's .npz; until it is written each array of a frame has a file of its own beside it."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._path, self._plan = path, plan
        self._files = ExitStack()
        self._columns: dict[str, BinaryIO] = {}
        self._row: Arrays = {}
        self._count = 0
        self.close = self._files.close

    def _column(self, name: str) -> Path:
        return self._path.with_name(f".{name}")

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Append one frame."""
        self._row, self._count = row(image, regions, self._plan), self._count + 1
        for name, array in self._row.items():
            if name not in self._columns:
                self._columns[name] = self._files.enter_context(self._column(name).open("wb"))
            self._columns[name].write(array.tobytes())

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the file, `provenance` as JSON in it."""
        self.close()
        columns = {
            name: np.memmap(self._column(name), array.dtype, "r", shape=(self._count, *array.shape))
            for name, array in self._row.items()
        }
        self.save(columns | frameless(self._plan, provenance), provenance)

    def save(self, arrays: Arrays, provenance: Mapping[str, Any]) -> None:
        """Write arrays, and `provenance` as one more."""
        text = np.array(json.dumps(provenance, indent=1))
        with zipfile.ZipFile(self._path, "w", allowZip64=True) as archive:
            for name, array in (arrays | {"provenance": text}).items():
                entry = zipfile.ZipInfo(f"{name}.npy")  # without a date, so that equal exports are equal files
                with archive.open(entry, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)


class Hdf5Writer(NpzWriter):
    """HDF5, with units and dimensions of each array as netCDF has them."""

    def save(self, arrays: Arrays, provenance: Mapping[str, Any]) -> None:
        """Write arrays as datasets, and `provenance` as an attribute of the file."""
        import h5py

        with _DeferredErrors(self._path, "w+") as disk:
            with h5py.File(disk, "w") as file:
                for name, array in arrays.items():
                    dataset = _add_dataset(file, name, array)
                    dataset.attrs.update(attributes(name, provenance))
                names = dimensions(self._plan)
                for name in arrays:
                    _add_dimensions(file, name, names.get(name, ("time",)))
                file.attrs["provenance"] = json.dumps(provenance, indent=1)
            if disk.error is not None:
                raise disk.error


def _add_dataset(file: Any, name: str, array: NDArray[Any]) -> Any:
    """Copy an array piece by piece; HDF5 has texts of frames as bytes, labels as texts."""
    dtype: Any = array.dtype
    if dtype.kind == "U":
        dtype = np.dtype(f"S{dtype.itemsize // 4}") if name not in LABELS else np.dtypes.StringDType()
    dataset = file.create_dataset(name, array.shape, dtype)
    for start in range(0, len(array), FRAMES_AT_ONCE):
        piece = slice(start, start + FRAMES_AT_ONCE)
        dataset[piece] = array[piece].astype(dtype, copy=False)
    return dataset


def _add_dimensions(file: Any, name: str, dimensions: tuple[str, ...]) -> None:
    """Name an array's dimensions by scales, of which those without values are none of its arrays."""
    array = file[name]
    for axis, each in enumerate(dimensions):
        if each not in file:
            size = array.shape[axis]
            file.create_dataset(each, (size,), ">f4").make_scale(NO_VARIABLE.format(size))
        elif not file[each].is_scale:
            file[each].make_scale(each)
        if each != name:
            array.dims[axis].attach_scale(file[each])


class _DeferredErrors(io.FileIO):
    """A file that keeps its first error: HDF5 aborts the process at an error while it closes a file."""

    error: OSError | None = None  # after it nothing more is written

    def write(self, data: Any) -> int:
        """Write all of it, or nothing from the first error on."""
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while rest and self.error is None:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the size, unless a write has failed."""
        try:
            return super().truncate(size) if self.error is None else 0
        except OSError as error:
            self.error = error
        return 0


def loads(image: SensorImage, plan: SensorPlan) -> Arrays:
    """Restored shear of one frame, of a sensor that restores it, and its deviation, NaN where it is not known."""
    if not plan.restores_shear:
        return {}
    unknown = np.full((2, *image.restored.shape), np.nan, np.float32)
    found = {"traction": image.traction, "traction_deviation": image.traction_deviation}
    return {name: unknown if each is None else each.astype("<f4", copy=False) for name, each in found.items()}


def row(image: SensorImage, regions: Mapping[str, Measures], plan: SensorPlan) -> Arrays:
    """What an export has of one frame."""
    measures = {"regions": np.array([*regions.values()], "<f4")} if regions else {}
    shear = {} if image.shear is None else {"shear": image.shear.astype("<f4", copy=False)}
    noise = {"noise_kpa": np.array(image.noise, "<f8")} if image.unit == PRESSURE else {}
    return (
        shear
        | loads(image, plan)
        | noise
        | measures
        | {
            "raw": image.raw.astype("<f4", copy=False),
            "restored": image.restored.astype("<f4", copy=False),
            "flags": image.flags,
            "time": np.array(image.time, "<f8"),
            "sequence": np.array(image.sequence, "<i8"),
            "method": np.array(image.method, METHOD_NAME),
            "noise": np.array(image.noise, "<f8"),
            "loss": np.array(astuple(image.loss), "<i8"),
        }
    )


def frameless(plan: SensorPlan, provenance: Mapping[str, Any]) -> Arrays:
    """Arrays that are of no frame: positions, and labels of the loss counts and of the regions' values."""
    labels = {name: np.array([*provenance[key]]) for name, key in LABELS.items() if key in provenance}
    return {"positions_mm": plan.array.positions, "cells_mm": plan.cells.positions} | labels


def dimensions(plan: SensorPlan) -> dict[str, tuple[str, ...]]:
    """Names of the dimensions of each array, ("time",) for any other."""
    taxels = ("row", "column") if len(plan.array.frame_shape) == 2 else ("taxel",)
    return {
        "raw": ("time", *taxels), "flags": ("time", *taxels), "restored": ("time", "cell_row", "cell_column"),
        **dict.fromkeys(("traction", "traction_deviation"), ("time", "axis", "cell_row", "cell_column")),
        "shear": ("time", "axis", *taxels), "loss": ("time", "loss_kind"),
        "regions": ("time", "region", "measure"),
        "positions_mm": ("taxel", "axis"), "cells_mm": ("cell", "axis"), **{name: (name,) for name in LABELS},
    }  # fmt: skip


def attributes(name: str, provenance: Mapping[str, Any]) -> Attributes:
    """Attributes of an array by the CF conventions: units, what it is, and the meaning of flags."""
    texts = {"units": provenance.get("units", {}), "long_name": provenance.get("descriptions", {})}
    found = {key: some[name] for key, some in texts.items() if name in some}
    if name == "regions":  # whose measures have a unit each, which is none of CF's
        found["measure_units"] = found.pop("units", "")
    if name != "flags":
        return found
    bits: Mapping[str, int] = provenance.get("flag_bits", {})
    meanings = " ".join(bits).lower()
    return found | {"flag_masks": np.array([*bits.values()], np.uint8), "flag_meanings": meanings}


class Chunk:
    """Rows of frames, until there are enough of them for one chunk of a file."""

    def __init__(self) -> None:
        self._rows: list[Arrays] = []
        self.frames = 0  # of a full one

    def add(self, row: Arrays) -> bool:
        """Take a row; whether the chunk is full."""
        largest = max(each.nbytes for each in row.values())
        self.frames = self.frames or max(1, min(FRAMES_AT_ONCE, CHUNK_BYTES // largest))
        self._rows.append(row)
        return len(self._rows) == self.frames

    def take(self) -> Arrays:
        """The rows as arrays, none of them where there is none; the chunk is empty afterwards."""
        rows, self._rows = self._rows, []
        return {name: np.stack([each[name] for each in rows]) for name in rows[0]} if rows else {}
