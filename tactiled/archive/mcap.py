"""Exports as MCAP: images and status in Foxglove's schemas, and the bus's data frames."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import IndexType, Writer

from tactiled import __version__
from tactiled.archive import writers
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import Message, SensorImage
from tactiled.messages import foxglove
from tactiled.units import nanoseconds


class McapWriter(writers.Writer):
    """One MCAP file, written as messages and images come.

    A record's publish time is its own; its log time never falls, though an image, of the time of its frame's first
    message, follows the last one.
    """

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._file = path.open("wb")
        self.close = self._file.close
        indexes = IndexType.ALL & ~IndexType.ATTACHMENT  # of none, the library writes an offset to nothing
        self._writer: Any = Writer(self._file, index_types=indexes)  # partly untyped
        self._writer.start(library=f"tactiled {__version__}")
        self._topics = foxglove.Topics(plan, plan.unit)
        self._bus, self._regions = foxglove.bus_topic(plan.bus), foxglove.regions_topic(plan.name)
        self._channels: dict[str, int] = {}  # of topics that have a message
        self._newest_ns = 0

    def _channel(self, topic: foxglove.Topic) -> int:
        schema = self._writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_data)
        return int(self._writer.register_channel(topic.name, topic.encoding, schema))

    def _add(self, topic: foxglove.Topic, time: float, data: bytes) -> None:
        if topic.name not in self._channels:
            self._channels[topic.name] = self._channel(topic)
        at = nanoseconds(time)
        self._newest_ns = max(self._newest_ns, at)
        self._writer.add_message(self._channels[topic.name], self._newest_ns, data, at)

    def add_message(self, message: Message) -> None:
        """Write one message of the bus."""
        self._add(self._bus, message.time, foxglove.bus_message(message))

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Write one image, its status and what its regions hold."""
        for topic, data in zip(self._topics.topics, self._topics.messages(image), strict=False):
            self._add(topic, image.time, data)
        if regions:
            self._add(self._regions, image.time, foxglove.regions_message(image.unit, regions))

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the rest, `provenance` in the metadata."""
        self._writer.add_metadata("provenance", {"json": json.dumps(provenance)})
        self._writer.finish()
        self._file.close()
