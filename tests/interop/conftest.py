from contextlib import ExitStack

import pytest

from tactiled.config import Server, Zenoh
from tactiled.interop.zenoh.app import create
from tactiled.interop.zenoh.session import open_session
from tactiled.interop.zenoh.signatures import robot_key
from tactiled.web.server import on_thread
from tests.conftest import until
from tests.interop.zenoh_kit import KEY, NAME, fleet_at, published
from tests.process import free_port

ROUTER = '{mode: "router", listen: {endpoints: ["%s"]}, scouting: {multicast: {enabled: false}}}'


@pytest.fixture
def served(rig):
    """Publishes the rig from this process and serves it; gives the fleet and the address of its API."""
    with ExitStack() as stack:

        def start(reader_server=Server(), server=Server(port=0), **settings):  # noqa: B008
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            listening = fleet_at("", mode="peer", connect=[], listen=[endpoint], **settings)
            fleet = stack.enter_context(listening)
            stack.enter_context(published(rig, endpoint, reader_server, **settings))
            until(lambda: NAME in fleet.sensors)
            return fleet, stack.enter_context(on_thread(create(fleet, server), server)) + "/api/v1"

        yield start


@pytest.fixture
def routed(rig):
    """The same by a router, each side with a key; gives a third peer's session, too."""
    with ExitStack() as stack:

        def start(fleet_key=KEY, key=robot_key(KEY, "r1"), server=Server(port=0), token=None):  # noqa: B008
            import zenoh

            endpoint = f"tcp/127.0.0.1:{free_port()}"
            stack.enter_context(zenoh.open(zenoh.Config.from_json5(ROUTER % endpoint)))
            fleet = stack.enter_context(fleet_at(endpoint, control_key=fleet_key))
            reader_server = Server(control_token=token)
            stack.enter_context(published(rig, endpoint, reader_server, control_key=key, mode="client"))
            until(lambda: NAME in fleet.sensors)
            session = stack.enter_context(open_session(Zenoh(mode="client", connect=[endpoint])))
            return fleet, stack.enter_context(on_thread(create(fleet, server), server)) + "/api/v1", session

        yield start
