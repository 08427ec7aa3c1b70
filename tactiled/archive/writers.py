"""Formats of exports: what a writer is, and the table of writers by the ending of their file's name."""

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast

from tactiled.build import SensorPlan
from tactiled.contacts.detection import DetectedContact
from tactiled.contacts.regions import Measures
from tactiled.errors import ConfigError
from tactiled.frames import Message, SensorImage


class Writer(Protocol):
    """One export under way. Beside `path` it may have temporary files, which are removed after it."""

    contacts: Callable[[SensorImage, float], tuple[DetectedContact, ...]]  # finds them; set before the first image
    close: Callable[[], object]  # lets go of every file, complete or not; once more does nothing

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        """Start a file or folder at `path`, which is not there yet, for the images of one sensor."""

    def add_message(self, message: Message) -> None:
        """Take one data frame of the bus, before the image that it completes; most formats cannot hold one."""

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Append one frame: its times, raw and restored image, flags, method, loss; memory stays bounded.

        `regions` has the measures of every region, by its name.
        """

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Complete what is at `path`, with `provenance` (JSON's types) in it."""


class Format(NamedTuple):
    """Where a format's writer is, which is imported when it is used, and what it needs."""

    module: str
    writer: str
    extra: str = ""  # of pyproject.toml
    packages: tuple[str, ...] = ()  # of that extra; a missing one is named before the work starts


FORMATS = {
    ".npz": Format("tactiled.archive.arrays", "NpzWriter"),
    ".h5": Format("tactiled.archive.arrays", "Hdf5Writer", "hdf5", ("h5py",)),
    ".csv": Format("tactiled.archive.csv_table", "CsvWriter"),
    ".parquet": Format("tactiled.archive.parquet", "ParquetWriter", "parquet", ("pyarrow",)),
    ".mcap": Format("tactiled.archive.mcap", "McapWriter", "foxglove", ("mcap", "foxglove")),
    ".zarr": Format("tactiled.archive.zarr_group", "ZarrWriter", "zarr", ("zarr",)),
    ".rrd": Format("tactiled.archive.rrd", "RrdWriter", "rerun", ("rerun",)),
    "rosbag2": Format("tactiled.archive.rosbag2", "Rosbag2Writer", "ros", ("rosbags",)),
    "rosbag2-sqlite3": Format("tactiled.archive.rosbag2", "Rosbag2SqliteWriter", "ros", ("rosbags",)),
}


def writer(name: str, to: str | None = None) -> type[Writer]:
    """Writer of a format, by default for a file of this name; ConfigError if unknown, or its extra is missing."""
    suffix = Path(name).suffix if to is None else to if to in FORMATS else f".{to}"
    if suffix not in FORMATS:
        place = name if to is None else f"--to {to}"
        raise ConfigError(f"{place}: unsupported format; use {', '.join(FORMATS)}")
    format_ = FORMATS[suffix]
    for package in format_.packages:
        if not find_spec(package):
            raise ConfigError(
                f"--out: {suffix} needs {package}: pip install 'tactiled[{format_.extra}]', or export to .npz"
            )
    return cast(type[Writer], getattr(import_module(format_.module), format_.writer))
