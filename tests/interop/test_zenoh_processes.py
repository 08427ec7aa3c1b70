"""Readers and routers in processes of their own, killed, cut off and doubled."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from tactiled.errors import ReaderError, UnknownSensorError
from tactiled.interop.zenoh.session import Request, connected
from tests.conftest import BUSY_S, until
from tests.interop.zenoh_kit import NAME, detail, fleet_at, kinds, state
from tests.process import free_port

ROUTER = """
import sys, time, zenoh
config = zenoh.Config.from_json5('{mode: "router", scouting: {multicast: {enabled: false}}}')
for key, endpoint in zip(("listen", "connect"), sys.argv[1:]):
    config.insert_json5(key + "/endpoints", '["' + endpoint + '"]')
session = zenoh.open(config)
print("open", flush=True)
time.sleep(1e6)
"""


@pytest.fixture
def process():
    """Starts processes, and kills them at the end."""
    started = []

    def start(*arguments, **settings):
        started.append(subprocess.Popen([sys.executable, *arguments], text=True, **settings))
        return started[-1]

    yield start
    for each in started:
        each.kill()
        each.communicate()


@pytest.fixture
def router(process):
    """Starts a router at an endpoint, connected to that of another or to none."""

    def start(*endpoints):
        made = process("-c", ROUTER, *endpoints, stdout=subprocess.PIPE)
        assert made.stdout.readline() == "open\n"
        return made

    return start


@pytest.fixture
def reader(process):
    """Starts a reader."""
    return lambda *arguments, **settings: process("-m", "tests.interop.zenoh_reader", *arguments, **settings)


def follow(fleet):
    """Every image of r1/palm from now on, as (session, sequence, time)."""
    sensor, images = fleet.sensors[NAME], []
    sensor.hub.subscribe(lambda image: images.append((sensor.line.session, image.sequence, image.time)))
    return images


def nothing_doubled(images):
    assert len(set(images)) == len(images)
    for session in {each[0] for each in images}:
        sequences = [each[1] for each in images if each[0] == session]
        assert sequences == sorted(sequences)


def test_a_silent_skin_a_killed_reader_and_a_stopped_one_differ_and_it_comes_back(reader, router):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router(endpoint)
    one = reader(endpoint, "r1")
    with fleet_at(endpoint) as fleet:
        until(lambda: state(fleet) == "live")
        images = follow(fleet)
        one.send_signal(signal.SIGUSR1)
        until(lambda: state(fleet) == "stale" and "no frame for" in detail(fleet))
        one.send_signal(signal.SIGUSR1)
        until(lambda: state(fleet) == "live")
        sensor = fleet.sensors[NAME]
        until(lambda: time.monotonic() - sensor.line.heard_at < 0.1)
        one.kill()
        until(lambda: state(fleet) == "down")
        assert "died" in detail(fleet)
        last = sensor.hub.latest()
        two = reader(endpoint, "r1")
        until(lambda: state(fleet) == "live")
        assert fleet.sensors[NAME] is sensor  # streams go on
        assert sensor.hub.latest().time > last.time
        two.terminate()
        until(lambda: "stopped" in detail(fleet))
        until(lambda: two.poll() is not None)
        assert len({session for session, _, _ in images}) == 2
        nothing_doubled(images)


def test_a_request_says_when_its_readers_connection_was_lost(reader):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with fleet_at(endpoint, mode="peer", connect=[], listen=[endpoint], control_key="ab" * 32) as fleet:
        one = reader(endpoint, "r1")
        until(lambda: state(fleet) == "live")
        one.send_signal(signal.SIGSTOP)
        threading.Timer(0.3, one.kill).start()  # one that stays frozen loses its connection after LEASE_S
        lost = r"was lost after [0-4]\.\d s, before it answered$"  # for a challenge: it is not done
        with pytest.raises(ReaderError, match=lost):
            fleet.request(NAME, Request("PUT", "method", body=b'{"method": "raw"}'))


def test_a_router_may_die_and_come_back(reader, router):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    first = router(endpoint)
    reader(endpoint, "r1")
    with fleet_at(endpoint) as fleet:
        until(lambda: state(fleet) == "live")
        images, session = follow(fleet), fleet.sensors[NAME].line.session
        first.kill()
        first.wait()
        until(lambda: "no connection" in detail(fleet))
        until(lambda: kinds(fleet, "sensor_down"))
        assert "no connection" in kinds(fleet, "sensor_down")[0]
        count = len(images)
        router(endpoint)
        until(lambda: state(fleet) == "live" and len(images) > count + 3)
        assert fleet.sensors[NAME].line.session == session
        assert fleet.sensors[NAME].status().loss.undelivered > 0
        nothing_doubled(images)


def test_a_server_that_only_listens_tells_how_its_last_reader_ended(reader):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with fleet_at(endpoint, mode="peer", connect=[], listen=[endpoint]) as fleet:
        with pytest.raises(UnknownSensorError, match="there are none"):
            fleet.sensor(NAME)
        one = reader(endpoint, "r1")
        until(lambda: state(fleet) == "live")
        one.kill()
        until(lambda: state(fleet) == "down" and not connected(fleet._questions.session))
        fleet._look_at, turns = 0.0, fleet._turns
        until(lambda: fleet._turns > turns + 1)
        assert "died" in detail(fleet)


def test_a_partition_is_told_from_a_dead_reader_and_what_waited_in_it_is_not_shown_as_new(reader, router):
    endpoint, far = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    router(endpoint)
    between = router(far, endpoint)
    reader(far, "r1")
    with fleet_at(endpoint) as fleet:
        until(lambda: state(fleet) == "live")
        images = follow(fleet)
        between.send_signal(signal.SIGSTOP)  # bytes and connections wait, and nobody is told
        until(lambda: state(fleet) == "stale")
        assert fleet.sensors[NAME].line.down is None  # its token is there until the lease ends
        until(lambda: state(fleet) == "down")
        assert "connection to its reader lost" in detail(fleet)
        between.send_signal(signal.SIGCONT)
        until(lambda: state(fleet) == "live")
        nothing_doubled(images)


def test_a_second_publisher_of_a_name_waits_says_so_and_follows_the_first(reader, router):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router(endpoint)
    one = reader(endpoint, "r1")
    with fleet_at(endpoint) as fleet:
        until(lambda: state(fleet) == "live")
        session = fleet.sensors[NAME].line.session
        two = reader(endpoint, "r1", stderr=subprocess.PIPE)
        line = two.stderr.readline()
        assert session in line
        assert "not published here: rename one" in line
        assert fleet.sensors[NAME].line.session == session
        one.kill()
        until(lambda: state(fleet) == "live" and fleet.sensors[NAME].line.session != session)


def test_the_clock_of_a_reader_that_is_wrong_is_named_and_no_age_is_wrong_by_it(reader):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with fleet_at("", mode="peer", connect=[], listen=[endpoint]) as fleet:
        reader(endpoint, "r1", "-300", stderr=subprocess.DEVNULL)
        until(lambda: kinds(fleet, "clock_skewed"))
        assert "behind" in kinds(fleet, "clock_skewed")[0]
        offset = fleet.sensors[NAME].line.offset
        assert offset.offset_s == pytest.approx(-300, abs=offset.error_s + 0.05)
        until(lambda: 0 <= (fleet.sensors[NAME].status().age_s or 0) < 1)


def test_a_server_imports_no_can(process):
    served = process("-c", "import sys, tactiled.cli.serve; sys.exit('can' in sys.modules)")
    assert served.wait(BUSY_S) == 0
