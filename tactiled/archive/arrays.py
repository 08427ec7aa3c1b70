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

from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import Image, Loss, Message
from tactiled.units import PRESSURE

Arrays = dict[str, NDArray[Any]]
LOSS_KINDS = tuple(each.name for each in fields(Loss))
METHOD_NAME = "<U16"  # longer than any method's name
FRAMES_AT_ONCE = 1024  # that are copied to HDF5


class NpzWriter:
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

    def add_message(self, message: Message) -> None:
        """Take one message, before the image that it completes."""

    def add_image(self, image: Image, regions: Mapping[str, Measures]) -> None:
        """Append one frame."""
        self._row, self._count = row(image, regions), self._count + 1
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
        places = {"positions_mm": self._plan.array.positions, "cells_mm": self._plan.cells.positions}
        self.save(self._path, columns | places, provenance)

    @staticmethod
    def save(path: Path, arrays: Arrays, provenance: Mapping[str, Any]) -> None:
        """Write arrays, and `provenance` as one more."""
        text = np.array(json.dumps(provenance, indent=1))
        with zipfile.ZipFile(path, "w", allowZip64=True) as archive:
            for name, array in (arrays | {"provenance": text}).items():
                entry = zipfile.ZipInfo(f"{name}.npy")  # without a date, so that equal exports are equal files
                with archive.open(entry, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)


class Hdf5Writer(NpzWriter):
    """HDF5, with the unit of each array beside it."""

    @staticmethod
    def save(path: Path, arrays: Arrays, provenance: Mapping[str, Any]) -> None:
        """Write arrays as datasets, and `provenance` as an attribute of the file."""
        import h5py

        with _DeferredErrors(path, "w+") as disk:
            with h5py.File(disk, "w") as file:
                for name, array in arrays.items():
                    _add_dataset(file, name, array, provenance["units"].get(name))
                file.attrs["provenance"] = json.dumps(provenance, indent=1)
            if disk.error is not None:
                raise disk.error


def _add_dataset(file: Any, name: str, array: NDArray[Any], unit: str | None) -> None:
    """Copy an array piece by piece; HDF5 has texts as bytes."""
    dtype = np.dtype(f"S{array.dtype.itemsize // 4}") if array.dtype.kind == "U" else array.dtype
    dataset = file.create_dataset(name, array.shape, dtype)
    for start in range(0, len(array), FRAMES_AT_ONCE):
        piece = slice(start, start + FRAMES_AT_ONCE)
        dataset[piece] = array[piece].astype(dtype, copy=False)
    if unit is not None:
        dataset.attrs["units"] = unit


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


def row(image: Image, regions: Mapping[str, Measures]) -> Arrays:
    """What an export has of one frame."""
    measures = {"regions": np.array([*regions.values()], "<f4")} if regions else {}
    shear = {} if image.shear is None else {"shear": image.shear.astype("<f4", copy=False)}
    noise = {"noise_kpa": np.array(image.noise, "<f8")} if image.unit == PRESSURE else {}
    return (
        shear
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
