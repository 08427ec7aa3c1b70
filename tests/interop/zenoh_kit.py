from contextlib import contextmanager, suppress
from functools import partial

from tactiled.config import Server, Zenoh
from tactiled.interop.zenoh.fleet import Fleet
from tactiled.interop.zenoh.reader import Requests, publisher
from tactiled.web.app import create
from tests.conftest import until

NAME = "r1/palm"
TOKEN, KEY = "0123456789abcdef", "0123456789abcdef" * 4


@contextmanager
def fleet_at(endpoint, **settings):
    """A server's sensors, and every image of r1/palm that it shows, by session."""
    fleet = Fleet(Zenoh(**({"mode": "client", "connect": [endpoint]} | settings)), Server())
    with fleet.running():
        yield fleet


@contextmanager
def published(rig, endpoint, server=Server(), **settings):  # noqa: B008, frozen
    """A rig's sensors on the network, from this process."""
    settings = Zenoh(connect=[endpoint], robot="r1", **settings)
    requests = Requests(create(rig.service, server), server, settings)
    with requests.running(), publisher(rig.service, settings, requests).running():
        yield


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
