"""Exports as MCAP: images and status in Foxglove's schemas, and the bus's data frames."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from tactiled import __version__
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import Image, Message
from tactiled.interop import foxglove
from tactiled.units import nanoseconds


class McapWriter:
    """One MCAP file, written as messages and images come."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        self._file = path.open("wb")
        self.close = self._file.close
        self._writer: Any = Writer(self._file)  # partly untyped
        self._writer.start(library=f"tactiled {__version__}")
        self._name, self._topics = plan.name, foxglove.Topics(plan, plan.unit)
        self._bus = self._channel(foxglove.bus_topic(plan.bus))
        self._regions: int | None = None  # the channel of the regions
        self._channels = [self._channel(each) for each in self._topics.topics]

    def _channel(self, topic: foxglove.Topic) -> int:
        schema = self._writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_data)
        return int(self._writer.register_channel(topic.name, topic.encoding, schema))

    def _add(self, channel: int, time: float, data: bytes) -> None:
        at = nanoseconds(time)
        self._writer.add_message(channel, at, data, at)

    def add_message(self, message: Message) -> None:
        """Write one message of the bus."""
        self._add(self._bus, message.time, foxglove.bus_message(message))

    def add_image(self, image: Image, regions: Mapping[str, Measures]) -> None:
        """Write one image, its status and what its regions hold."""
        for channel, data in zip(self._channels, self._topics.messages(image), strict=True):
            self._add(channel, image.time, data)
        if regions:
            if self._regions is None:
                self._regions = self._channel(foxglove.regions_topic(self._name))
            self._add(self._regions, image.time, foxglove.regions_message(image.unit, regions))

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the rest, `provenance` in the metadata."""
        self._writer.add_metadata("provenance", {"json": json.dumps(provenance)})
        self._writer.finish()
        self._file.close()
