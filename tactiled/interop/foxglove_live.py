"""A server for Foxglove's apps: newest wins, and no message is made without a subscriber."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from typing import TYPE_CHECKING

from tactiled.errors import TactileError
from tactiled.frames import Image
from tactiled.interop import foxglove
from tactiled.live.sensor import Sensor
from tactiled.units import Unit, nanoseconds

with suppress(ImportError):  # `foxglove.need` says so
    import foxglove as sdk

if TYPE_CHECKING:
    from tactiled.live.service import Service

STATE_EVERY_S = 1.0  # between two messages on a sensor's state, at most
CONTACTS_EVERY_S = 0.05  # between two messages on contacts, at least
BACKLOG = 32  # messages that wait for one client of the server; the oldest is dropped


class _SensorChannels:
    """One sensor's topics on the server."""

    def __init__(self, context: "sdk.Context", sensor: Sensor, wake: Callable[[], None]) -> None:
        def channel(topic: foxglove.Topic) -> "sdk.Channel":
            schema = sdk.Schema(name=topic.schema, encoding=topic.schema_encoding, data=topic.schema_data)
            return sdk.Channel(topic.name, schema=schema, message_encoding=topic.encoding, context=context)

        self.sensor, self._channel = sensor, channel
        self._images: list[sdk.Channel] = []
        self._advertise_images(sensor.plan.unit)
        self._state = channel(foxglove.state_topic(sensor.name))
        self._contacts = channel(foxglove.contacts_topic(sensor.name))
        self._image: Image | None = None  # the last one sent
        self._state_sent = ""
        self._state_sent_at = self._contacts_sent_at = -STATE_EVERY_S
        self.unsubscribe = sensor.hub.subscribe(lambda _: wake())

    def _advertise_images(self, unit: Unit) -> None:
        """Advertise the topics of images, whose schemas name the unit of pressure."""
        for each in self._images:
            each.close()
        self._topics = foxglove.Topics(self.sensor.plan, unit)
        self._images = [self._channel(topic) for topic in self._topics.topics]

    def close(self) -> None:
        """Take the topics back."""
        self.unsubscribe()
        for each in (*self._images, self._state, self._contacts):
            each.close()

    def send(self, now: float) -> None:
        """Send what is new at `now` (s, monotonic) to the subscribers."""
        image = self.sensor.hub.latest()
        if image is not None and image.unit != self._topics.unit:
            self._advertise_images(image.unit)
        images_subscribed = any(channel.has_sinks() for channel in self._images)
        contacts_subscribed = self._contacts.has_sinks()
        if image is not None and image is not self._image and (images_subscribed or contacts_subscribed):
            self._image = image
            if images_subscribed:
                for channel, message in zip(self._images, self._topics.messages(image), strict=True):
                    channel.log(message, log_time=nanoseconds(image.time))
            if contacts_subscribed and now - self._contacts_sent_at >= CONTACTS_EVERY_S:
                self._contacts_sent_at = now
                self._send_contacts()
        if self._state.has_sinks():
            self._send_state(now)

    def _send_contacts(self) -> None:
        image, contacts = self.sensor.contacts()
        if image is not None:
            message = foxglove.contacts_message(self.sensor.name, image.time, image.unit, contacts)
            self._contacts.log(message, log_time=nanoseconds(image.time))

    def _send_state(self, now: float) -> None:
        """Send the state when it has changed, and every STATE_EVERY_S."""
        status = self.sensor.status()
        if status.state == self._state_sent and now - self._state_sent_at < STATE_EVERY_S:
            return
        self._state_sent, self._state_sent_at = status.state, now
        values = {name: getattr(status, name, None) for name in foxglove.STATE}
        values |= {"method": self.sensor.method, "loss": asdict(status.loss)}
        content = {name: value for name, value in values.items() if value is not None}
        self._state.log(json.dumps(content).encode(), log_time=time.time_ns())


@contextmanager
def bridge(service: "Service", port: int | None) -> Iterator[int | None]:
    """Serve Foxglove's apps meanwhile on a port of loopback (0: any free one); gives the port, None without."""
    if port is None:
        yield None
        return
    foxglove.need("server.foxglove")
    context = sdk.Context()
    try:
        server = sdk.start_server(
            name="tactiled", host="127.0.0.1", port=port, context=context, message_backlog_size=BACKLOG
        )
    except RuntimeError as error:
        raise TactileError(f"server.foxglove = {port}: {error}: choose another port, or 0 for any") from error
    sensors: dict[str, _SensorChannels] = {}
    new, ended = threading.Event(), threading.Event()

    def follow() -> None:
        """Have the topics of the sensors that there are now."""
        present = service.sensors
        for name in [name for name, each in sensors.items() if present.get(name) is not each.sensor]:
            sensors.pop(name).close()
        for name in [name for name in present if name not in sensors]:
            sensors[name] = _SensorChannels(context, present[name], new.set)

    def work() -> None:
        while not ended.is_set():
            with service.faults.turn("foxglove"):
                follow()
            new.wait(STATE_EVERY_S / 2)
            new.clear()
            for name, channels in sensors.items():
                with service.faults.turn(f"foxglove of {name}"):
                    channels.send(time.monotonic())

    thread = threading.Thread(target=work, name="foxglove", daemon=True)
    follow()
    thread.start()
    try:
        yield server.port
    finally:
        ended.set()
        new.set()
        thread.join()
        for each in sensors.values():
            each.unsubscribe()
        server.stop()
