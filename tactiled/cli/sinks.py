"""Where an export goes: a file of arrays, or one for Foxglove."""

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import astuple
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import numpy as np

from tactiled import __version__
from tactiled.build import SensorPlan
from tactiled.cli.columns import Arrays, Columns, save_hdf5, save_npz
from tactiled.errors import ConfigError
from tactiled.frames import Image, Message
from tactiled.interop import foxglove

METHOD = "<U16"  # longer than any method's name


class Sink(AbstractContextManager["Sink"]):
    """What takes a recording's messages and images one by one, and makes one file of them."""

    @classmethod
    def check(cls) -> None:
        """Raise ConfigError where what it needs is not installed."""

    def __init__(self, path: Path, room: Path, plan: SensorPlan) -> None:
        """Write to `path`, and what is needed meanwhile into the directory `room`."""
        self._path, self._room, self._plan = path, room, plan

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def message(self, message: Message) -> None:
        """Take one message, before the image that it completes."""

    def image(self, image: Image) -> None:
        """Take one image."""
        raise NotImplementedError

    def end(self, about: dict[str, Any]) -> None:
        """Write the rest of the file, `about` in it."""
        raise NotImplementedError


class _ArraySink(Sink):
    save: Callable[[Columns, Path, Arrays, dict[str, Any]], None]

    def __init__(self, path: Path, room: Path, plan: SensorPlan) -> None:
        super().__init__(path, room, plan)
        self._columns = Columns(room)

    def image(self, image: Image) -> None:
        self._columns.add(row(image))

    def end(self, about: dict[str, Any]) -> None:
        places = {"positions_mm": self._plan.array.positions, "cells_mm": self._plan.cells.positions}
        type(self).save(self._columns, self._path, places, about)


class NpzSink(_ArraySink):
    """numpy's .npz."""

    save = staticmethod(save_npz)


class Hdf5Sink(_ArraySink):
    """HDF5."""

    save = staticmethod(save_hdf5)

    @classmethod
    def check(cls) -> None:
        """Raise ConfigError where h5py is not installed."""
        if not find_spec("h5py"):
            raise ConfigError("--out: .h5 needs h5py: pip install 'tactiled[hdf5]', or export to .npz")


class McapSink(Sink):
    """MCAP: images and status in Foxglove's schemas, and the bus's data frames."""

    @classmethod
    def check(cls) -> None:
        """Raise ConfigError where mcap or Foxglove's SDK is not installed."""
        if not find_spec("mcap"):
            raise ConfigError("--out: .mcap needs mcap: pip install 'tactiled[foxglove]', or export to .npz")
        foxglove.need("--out: .mcap")

    def __enter__(self) -> Self:
        from mcap.writer import Writer

        plan = self._plan
        self._file = self._path.open("wb")
        self._writer: Any = Writer(self._file)  # partly untyped
        self._writer.start(library=f"tactiled {__version__}")
        self._topics = foxglove.Topics(plan.name, plan.array, plan.cells, plan.blur.surface_shape, plan.shears)
        self._bus = self._channel(foxglove.bus_topic(plan.bus))
        self._channels = [self._channel(each) for each in self._topics.topics]
        return self

    def _channel(self, topic: foxglove.Topic) -> int:
        schema = self._writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_data)
        return int(self._writer.register_channel(topic.name, topic.encoding, schema))

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _add(self, channel: int, time: float, data: bytes) -> None:
        at = foxglove.stamp(time)
        self._writer.add_message(channel, at, data, at)

    def message(self, message: Message) -> None:
        """Keep it."""
        self._add(self._bus, message.time, foxglove.bus_message(message))

    def image(self, image: Image) -> None:
        """Keep it, with its status."""
        for channel, data in zip(self._channels, self._topics.messages(image), strict=True):
            self._add(channel, image.time, data)

    def end(self, about: dict[str, Any]) -> None:
        """Write the rest, `about` in the metadata."""
        self._writer.add_metadata("provenance", {"json": json.dumps(about)})
        self._writer.finish()
        self._file.close()


FORMATS: dict[str, type[Sink]] = {".npz": NpzSink, ".h5": Hdf5Sink, ".mcap": McapSink}


def row(image: Image) -> Arrays:
    """What is kept of one frame."""
    shear = {} if image.shear is None else {"shear": image.shear.astype("<f4", copy=False)}
    return shear | {
        "raw": image.raw.astype("<f4", copy=False),
        "restored": image.restored.astype("<f4", copy=False),
        "flags": image.flags,
        "time": np.array(image.time, "<f8"),
        "sequence": np.array(image.sequence, "<i8"),
        "method": np.array(image.method, METHOD),
        "noise_kpa": np.array(image.noise_kpa, "<f8"),
        "loss": np.array(astuple(image.loss), "<i8"),
    }
