"""The seam of other systems' protocols: each is a bridge, and nothing below knows which there are."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, NamedTuple

import uvicorn
from fastapi import APIRouter

from tactiled.config import Server
from tactiled.frames import SensorImage
from tactiled.live.sensor import Sensor
from tactiled.web.ws.feed import Feeds

if TYPE_CHECKING:  # which imports python-can: `tactiled serve` needs none
    from tactiled.live.service import Service

LOOK_S = 0.5  # from one call of `status` to the next, at most


class Host(NamedTuple):
    """What a bridge gets when it starts."""

    service: "Service"
    server: Server
    beside: list[uvicorn.Server]  # which end with the service's own; a bridge may add one


class Bridge:
    """Another system's protocol: `start`, `on_image`, `on_status`, `stop`; a subclass gives what it needs.

    All but `start` and `routes` run on one thread of the bridge. An exception there is a fault of the service, and
    `/health` names it. A bridge with a thread of its own gives `running` instead.
    """

    name = "bridge"  # of its thread and its faults

    def start(self, host: Host) -> str | None:
        """Open; gives in words where it is, for the log; TactileError, one line, where it cannot be had."""

    def enter(self, sensor: Sensor) -> None:
        """A sensor is there from now on; after a reload another object may have its name."""

    def on_image(self, sensor: Sensor, image: SensorImage) -> bool:
        """The newest image; whether it was sent: if not, it comes again until there is a newer one."""
        raise NotImplementedError

    def on_status(self, sensor: Sensor, now: float) -> None:
        """The time to look at `sensor.status()`: after every image, and each LOOK_S; `now` in s, monotonic."""

    def leave(self, sensor: Sensor) -> None:
        """A sensor is no longer there."""

    def stop(self) -> None:
        """Close."""

    def routes(self, feeds: Feeds) -> APIRouter | None:
        """What it serves at the service's own address."""

    def described(self) -> dict[str, dict[str, Any]]:
        """Its WebSockets for AsyncAPI: `channels`, `operations` and `messages` by name."""
        return {}

    @contextmanager
    def running(self, host: Host) -> Iterator[str | None]:
        """Run meanwhile; gives what `start` gives."""
        service, sent = host.service, dict[Sensor, SensorImage | None]()
        new, ended, unsubscribe = Event(), Event(), dict[Sensor, Callable[[], None]]()
        where = self.start(host)

        def follow() -> None:
            present = service.sensors
            for sensor in [each for each in sent if present.get(each.name) is not each]:
                sent.pop(sensor)
                unsubscribe.pop(sensor)()
                self.leave(sensor)
            for sensor in [each for each in present.values() if each not in sent]:
                self.enter(sensor)
                sent[sensor] = None
                unsubscribe[sensor] = sensor.hub.subscribe(lambda _: new.set())

        def work() -> None:
            while not ended.is_set():
                with service.faults.turn(self.name):
                    follow()
                new.wait(LOOK_S)
                new.clear()
                for sensor in sent:
                    with service.faults.turn(f"{self.name} of {sensor.name}"):
                        image = sensor.hub.latest()
                        if image is not None and image is not sent[sensor]:
                            before, sent[sensor] = sent[sensor], image  # one that fails is not tried again
                            if not self.on_image(sensor, image):
                                sent[sensor] = before
                        self.on_status(sensor, time.monotonic())

        follow()
        thread = Thread(target=work, name=self.name, daemon=True)
        thread.start()
        try:
            yield where
        finally:
            ended.set()
            new.set()
            thread.join()
            for each in unsubscribe.values():
                each()
            self.stop()
