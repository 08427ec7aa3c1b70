"""Arrays that grow by a frame at a time, on the disk, and the files that they end in."""

import io
import json
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
PIECE = 1 << 20  # bytes that are copied at a time


class Columns:
    """One file for each array of a frame, so that a long recording needs no memory."""

    def __init__(self, room: Path) -> None:
        self._room = room
        self._open: dict[str, BinaryIO] = {}
        self._forms: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
        self._closing = ExitStack()
        self.count = 0

    def add(self, row: Arrays) -> None:
        """Append one frame."""
        for name, array in row.items():
            if name not in self._open:
                self._open[name] = self._closing.enter_context((self._room / name).open("wb"))
                self._forms[name] = array.dtype, array.shape
            self._open[name].write(array.tobytes())
        self.count += 1

    def each(self) -> Iterator[tuple[str, np.dtype[Any], tuple[int, ...], Path]]:
        """Name, type, shape (frames first) and file of every array; nothing can be added after that."""
        self._closing.close()
        for name, (dtype, shape) in self._forms.items():
            yield name, dtype, (self.count, *shape), self._room / name


def save_npz(columns: Columns, path: Path, places: Arrays, about: dict[str, Any]) -> None:
    """Write everything as numpy's .npz, `about` as JSON in `provenance`."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name, dtype, shape, file in columns.each():
            with _entry(archive, name) as entry, file.open("rb") as column:
                _header(entry, dtype, shape)
                shutil.copyfileobj(column, entry, PIECE)
        for name, array in (places | {"provenance": np.array(json.dumps(about, indent=1))}).items():
            with _entry(archive, name) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)


def _entry(archive: zipfile.ZipFile, name: str) -> Any:
    """A new member; its date is not today's, so that the same export is the same file."""
    return archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True)


def _header(entry: Any, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    told = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(entry, told)


def save_hdf5(columns: Columns, path: Path, places: Arrays, about: dict[str, Any]) -> None:
    """Write everything as HDF5: each array with its `units`, `about` as JSON in the file's `provenance`."""
    import h5py

    with _Unfailing(path, "w+") as disk:
        with h5py.File(disk, "w") as file:
            _fill(file, columns, places, about)
        if disk.error is not None:
            raise disk.error


def _fill(file: Any, columns: Columns, places: Arrays, about: dict[str, Any]) -> None:
    for name, dtype, shape, column in columns.each():
        kept = np.dtype(f"S{dtype.itemsize // 4}") if dtype.kind == "U" else dtype
        made = file.create_dataset(name, shape, kept)
        values = np.memmap(column, dtype, "r", shape=shape)
        for start in range(0, shape[0], step := max(1, PIECE // max(1, values[0].nbytes))):
            made[start : start + step] = values[start : start + step].astype(kept, copy=False)
    for name, array in places.items():
        file[name] = array
    for name, unit in about["units"].items():
        file[name].attrs["units"] = unit
    file.attrs["provenance"] = json.dumps(about, indent=1)


class _Unfailing(io.FileIO):
    """A file whose errors HDF5 does not see: one as it closes a file would end the process."""

    error: OSError | None = None  # the first, after which nothing more is written

    def write(self, data: Any) -> int:
        """Write all of it, or nothing more ever."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left and self.error is None:
                left = left[super().write(left) :]
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
