"""Exports as rosbag2: a folder with one file, MCAP or sqlite3, that holds the images as ROS 2's messages."""

import errno
import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from tactiled.archive import writers
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import SensorImage
from tactiled.messages import ros
from tactiled.units import nanoseconds

VERSION: Literal[8] = 8  # of metadata.yaml: rosbag2 from Humble to 0.34 reads it; 9 has QoS that Iron cannot


class Rosbag2Writer(writers.Writer):
    """One bag with MCAP storage, written as images come."""

    storage = StoragePlugin.MCAP

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._topics = ros.Topics(plan)
        self._writer = Writer(path, version=VERSION, storage_plugin=self.storage)
        self._empty = True
        with _os_errors():
            self._writer.open()
        self._connections: dict[str, Connection] = {}  # of topics that have a message

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Write one image, its contacts, regions and status, at the time of its frame."""
        if self._empty:
            self._write(self._topics.first(image.time), image.time)
            self._empty = False
        self._write(self._topics.messages(image, self.contacts(image, image.time), regions), image.time)

    def _write(self, messages: Iterator[ros.Message], time_s: float) -> None:
        with _os_errors():
            for topic, data in messages:
                if topic not in self._connections:
                    self._connections[topic] = self._connection(topic)
                self._writer.write(self._connections[topic], nanoseconds(time_s), data)

    def _connection(self, topic: str) -> Connection:
        (kind, qos), store = ros.TOPICS[topic], self._topics.types.store
        name = self._topics.full_name(topic)
        return self._writer.add_connection(name, kind, typestore=store, offered_qos_profiles=[qos])

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Complete the bag, with `provenance` in its metadata."""
        self._writer.set_custom_data("provenance", json.dumps(provenance))
        with _os_errors():
            self._writer.close()

    def close(self) -> None:
        """Let go of the bag's file, complete or not."""
        with suppress(OSError, sqlite3.Error):  # of a full disk, which is reported already
            self._writer.abort()


class Rosbag2SqliteWriter(Rosbag2Writer):
    """The same with sqlite3 storage, the default of ROS 2 up to Humble."""

    storage = StoragePlugin.SQLITE3


@contextmanager
def _os_errors() -> Iterator[None]:
    """OSError where sqlite3 cannot write, as from any other file."""
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(errno.EIO, str(error)) from error
