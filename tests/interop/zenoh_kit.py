from contextlib import contextmanager, suppress
from functools import partial

from tactiled.config import Server, Zenoh
from tactiled.interop.zenoh_fleet import Fleet
from tests.conftest import until

NAME = "r1/palm"


@contextmanager
def fleet_at(endpoint, **settings):
    """A server's sensors, and every image of r1/palm that it shows, by session."""
    fleet = Fleet(Zenoh(**({"mode": "client", "connect": [endpoint]} | settings)), Server())
    with fleet.running():
        yield fleet


def kinds(fleet, kind):
    return [event.text for event in fleet.events.after(0) if event.kind == kind]


def state(fleet):
    sensor = fleet.sensors.get(NAME)
    return sensor.status().state if sensor else None


def detail(fleet):
    return fleet.sensors[NAME].status().detail


def pass_on(rig, fleet, counts):
    """Show frames until one comes through: a busy link may drop some."""

    def passed(image):
        newest = fleet.sensors[NAME].hub.latest()
        return newest is not None and newest.sequence == image.sequence

    while True:
        image = rig.show(counts)
        with suppress(AssertionError):
            until(partial(passed, image), 5.0)
            return image
