"""A server for Foxglove's apps: newest wins, and no message is made without a subscriber."""

import json
import time
from contextlib import suppress
from dataclasses import asdict

from tactiled.errors import TactileError
from tactiled.frames import SensorImage
from tactiled.live.sensor import Sensor
from tactiled.messages import foxglove
from tactiled.units import Unit, nanoseconds
from tactiled.web.bridge import Bridge, Host

with suppress(ImportError):  # `foxglove.need` says so
    import foxglove as sdk

STATE_EVERY_S = 1.0  # between two messages on a sensor's state, at most
CONTACTS_EVERY_S = 0.05  # between two messages on contacts, at least
BACKLOG = 32  # messages that wait for one client of the server; the oldest is dropped


class _SensorChannels:
    """One sensor's topics on the server."""

    def __init__(self, context: "sdk.Context", sensor: Sensor) -> None:
        def channel(topic: foxglove.Topic) -> "sdk.Channel":
            schema = sdk.Schema(name=topic.schema, encoding=topic.schema_encoding, data=topic.schema_data)
            return sdk.Channel(topic.name, schema=schema, message_encoding=topic.encoding, context=context)

        self.sensor, self._channel = sensor, channel
        self._images: list[sdk.Channel] = []
        self._advertise_images(sensor.plan.unit)
        self._state = channel(foxglove.state_topic(sensor.name))
        self._contacts = channel(foxglove.contacts_topic(sensor.name))
        self._state_sent = ""
        self._state_sent_at = self._contacts_sent_at = -STATE_EVERY_S

    def _advertise_images(self, unit: Unit) -> None:
        """Advertise the topics of images, whose schemas name the unit of pressure."""
        for each in self._images:
            each.close()
        self._topics = foxglove.Topics(self.sensor.plan, unit)
        self._images = [self._channel(topic) for topic in self._topics.topics]

    def close(self) -> None:
        """Take the topics back."""
        for each in (*self._images, self._state, self._contacts):
            each.close()

    def send_image(self, image: SensorImage, now: float) -> bool:
        """Send an image at `now` (s, monotonic) to the subscribers; whether there are any."""
        if image.unit != self._topics.unit:
            self._advertise_images(image.unit)
        images_subscribed = any(channel.has_sinks() for channel in self._images)
        contacts_subscribed = self._contacts.has_sinks()
        if images_subscribed:
            for channel, message in zip(self._images, self._topics.messages(image), strict=False):
                channel.log(message, log_time=nanoseconds(image.time))
        if contacts_subscribed and now - self._contacts_sent_at >= CONTACTS_EVERY_S:
            self._contacts_sent_at = now
            self._send_contacts()
        return images_subscribed or contacts_subscribed

    def _send_contacts(self) -> None:
        image, contacts = self.sensor.contacts()
        if image is not None:
            message = foxglove.contacts_message(self.sensor.name, image.time, image.unit, contacts)
            self._contacts.log(message, log_time=nanoseconds(image.time))

    def send_state(self, now: float) -> None:
        """Send the state to subscribers when it has changed, and every STATE_EVERY_S."""
        if not self._state.has_sinks():
            return
        status = self.sensor.status()
        if status.state == self._state_sent and now - self._state_sent_at < STATE_EVERY_S:
            return
        self._state_sent, self._state_sent_at = status.state, now
        values = {name: getattr(status, name, None) for name in foxglove.STATE}
        values |= {"method": self.sensor.method, "loss": asdict(status.loss)}
        content = {name: value for name, value in values.items() if value is not None}
        self._state.log(json.dumps(content).encode(), log_time=time.time_ns())


class Foxglove(Bridge):
    """Serves Foxglove's apps on a port of loopback (0: any free one)."""

    name = "foxglove"

    def __init__(self, port: int) -> None:
        self._port = port
        self._sensors: dict[Sensor, _SensorChannels] = {}

    def start(self, _: Host) -> str:
        """Start the SDK's server."""
        foxglove.need("server.foxglove")
        self._context = sdk.Context()
        try:
            self._server = sdk.start_server(
                name="tactiled", host="127.0.0.1", port=self._port, context=self._context,
                message_backlog_size=BACKLOG,
            )  # fmt: skip
        except RuntimeError as error:
            setting = f"server.foxglove = {self._port}"
            raise TactileError(f"{setting}: {error}: choose another port, or 0 for any") from error
        return f"Foxglove at ws://127.0.0.1:{self._server.port}"

    def enter(self, sensor: Sensor) -> None:
        """Advertise a sensor's topics."""
        self._sensors[sensor] = _SensorChannels(self._context, sensor)

    def on_image(self, sensor: Sensor, image: SensorImage) -> bool:
        """Send an image and its contacts."""
        return self._sensors[sensor].send_image(image, time.monotonic())

    def on_status(self, sensor: Sensor, now: float) -> None:
        """Send the state."""
        self._sensors[sensor].send_state(now)

    def leave(self, sensor: Sensor) -> None:
        """Take a sensor's topics back."""
        self._sensors.pop(sensor).close()

    def stop(self) -> None:
        """Stop the server."""
        self._server.stop()
