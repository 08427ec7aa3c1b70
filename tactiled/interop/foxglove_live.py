"""What the sensors show, live in Foxglove's apps: newest wins, and nothing is made that nobody looks at."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

from tactiled.frames import Image
from tactiled.interop import foxglove
from tactiled.runtime.sensor import Sensor
from tactiled.runtime.service import Service

STATE_S = 1.0  # a client hears of a sensor's state at least this often
CONTACTS_S = 0.05  # between two messages on contacts


class _Line:
    """One sensor's topics."""

    def __init__(self, live: foxglove.Live, sensor: Sensor) -> None:
        plan, name = sensor.plan, sensor.name
        self._sensor = sensor
        self._topics = foxglove.Topics(name, plan.array, plan.cells, plan.blur.surface_shape, plan.shears)
        self._images = [live.channel(topic) for topic in self._topics.topics]
        self._state = live.channel(foxglove.state_topic(name))
        self._contacts = live.channel(foxglove.contacts_topic(name))
        self._shown: Image | None = None
        self._told = ""
        self._told_at = self._touched_at = -STATE_S

    def show(self, now: float) -> None:
        """Send what is new at `now` (s, monotonic) to whoever has subscribed."""
        image = self._sensor.hub.latest()
        seen = any(channel.has_sinks() for channel in (*self._images, self._contacts))
        if seen and image is not None and image is not self._shown:
            self._shown = image
            if any(channel.has_sinks() for channel in self._images):
                for channel, message in zip(self._images, self._topics.messages(image), strict=True):
                    channel.log(message, log_time=foxglove.stamp(image.time))
            if self._contacts.has_sinks() and now - self._touched_at >= CONTACTS_S:
                self._touch(now)
        if self._state.has_sinks():
            self._tell(now)

    def _touch(self, now: float) -> None:
        self._touched_at = now
        image, contacts = self._sensor.contacts()
        if image is not None:
            message = foxglove.contacts_message(self._sensor.name, image.time, contacts)
            self._contacts.log(message, log_time=foxglove.stamp(image.time))

    def _tell(self, now: float) -> None:
        """Send the state when it has changed, and at least every STATE_S."""
        status = self._sensor.status()
        if status.state == self._told and now - self._told_at < STATE_S:
            return
        self._told, self._told_at = status.state, now
        told = {
            "state": status.state,
            "detail": status.detail,
            "rate_hz": status.rate_hz,
            "method": self._sensor.method,
            "loss": asdict(status.loss),
        }
        known = {} if status.age_s is None else {"age_s": status.age_s}
        self._state.log(json.dumps(told | known).encode(), log_time=time.time_ns())


@contextmanager
def bridge(service: Service, port: int | None) -> Iterator[int | None]:
    """Serve Foxglove's apps meanwhile, where a port is given; gives the port that was taken."""
    if port is None:
        yield None
        return
    live = foxglove.Live(port)
    lines = {name: _Line(live, sensor) for name, sensor in service.sensors.items()}
    new, ended = threading.Event(), threading.Event()

    def work() -> None:
        while not ended.is_set():
            new.wait(STATE_S / 2)
            new.clear()
            for name, line in lines.items():
                with service.faults.turn(f"foxglove of {name}"):
                    line.show(time.monotonic())

    thread = threading.Thread(target=work, name="foxglove", daemon=True)
    leave = [sensor.hub.subscribe(lambda _: new.set()) for sensor in service.sensors.values()]
    thread.start()
    try:
        yield live.port
    finally:
        for each in leave:
            each()
        ended.set()
        new.set()
        thread.join()
        live.stop()
