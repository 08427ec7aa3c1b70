"""What one client may take: requests a minute, streams, costly answers, places, lines in the log."""

import asyncio
import logging
import math
import threading
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial

import pytest
from starlette.requests import Request
from websockets.sync.client import connect

from tactiled.config import Server
from tactiled.logs import MAX_A_MINUTE, LogLimit
from tactiled.web.http import connection_limit, limits
from tactiled.web.http.connection_limit import Place, Places
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit, Turns, client_of
from tactiled.web.http.problems import Problem
from tests.conftest import BUSY_S, ask, pressed, problem, run_apart, running, until
from tests.web.http.raw import websocket_url
from tests.web.ws.clients import closed

METHOD = "/api/v1/sensors/palm/method"


@pytest.fixture
def now():
    return [0.0]


def test_a_client_has_a_burst_and_then_its_rate(now):
    limit = RateLimit(60, lambda: now[0])
    assert [limit.take("a") for _ in range(10)] == [0.0] * 10  # a sixth of a minute's worth at once
    assert limit.take("a") == 1.0
    assert limit.take("b") == 0.0  # another client has a bucket of its own
    now[0] += 0.5
    assert limit.take("a") == 0.5
    now[0] += 0.5
    assert limit.take("a") == 0.0
    now[0] += 1e6
    assert sum(limit.take("a") == 0 for _ in range(100)) == 10  # a bucket does not overflow
    assert {RateLimit(0).take("a") for _ in range(10_000)} == {0.0}  # no limit


def test_a_refusal_says_when_to_try_again(now):
    limit = RateLimit(6, lambda: now[0])
    limit.count({"client": ("1.2.3.4", 1)})
    with pytest.raises(Problem, match="more than 1 at once, or 6 a minute: wait") as caught:
        limit.count({"client": ("1.2.3.4", 2)})
    assert (caught.value.status_code, caught.value.headers) == (429, {"Retry-After": "10"})
    now[0] += math.nextafter(10, 20)
    limit.count({"client": ("1.2.3.4", 3)})


def test_memory_is_bounded_for_any_number_of_clients(now, monkeypatch):
    monkeypatch.setattr(limits, "MAX_CLIENTS", 10)
    limit = RateLimit(6, lambda: now[0])
    for n in range(1000):
        limit.take(str(n))
    assert len(limit._buckets) == 10
    assert limit.take("999") > 0  # the newest are remembered


def scope(host):
    return {"type": "http", "client": (host, 1)}


def test_one_network_is_one_client():
    assert client_of(scope("2001:db8::1")) == client_of(scope("2001:db8::ffff:1"))
    assert client_of(scope("2001:db8::1")) != client_of(scope("2001:db8:0:1::1"))
    assert client_of(scope("fe80::1%eth0")) == client_of(scope("fe80::2%eth1"))
    assert client_of(scope("10.0.0.1")) == client_of(scope("::ffff:10.0.0.1")) == "10.0.0.1"
    assert client_of(scope("::1")) == "::1"
    assert client_of({"client": None}) == client_of({}) == ""
    assert client_of(scope("x" * 60_000)) == ""  # a proxy's header may be long


def test_a_client_has_its_number_of_streams_until_one_ends():
    streams = ConcurrencyLimit(2, 3)
    with streams.one(scope("a::1")), streams.one(scope("10.0.0.1")):
        with streams.one(scope("a::2")):
            assert streams.open == 3
            for host, status in (("a::3", 429), ("10.0.0.1", 503), ("10.0.0.2", 503)):
                with pytest.raises(Problem) as caught, streams.one(scope(host)):
                    pass
                assert caught.value.status_code == status
        with streams.one(scope("a::3")):
            assert streams.open == 3
        with pytest.raises(ZeroDivisionError), streams.one(scope("a::4")):
            raise ZeroDivisionError
    assert streams.open == 0
    assert len(streams._open) == 0  # who has none is forgotten
    assert streams.refused == {"streams_per_client": 1, "streams": 2}
    unlimited = ConcurrencyLimit(0, 0)
    with ExitStack() as stack:
        for _ in range(1000):
            stack.enter_context(unlimited.one(scope("10.0.0.1")))
        assert unlimited.open == 1000


def test_a_waiting_client_that_left_or_was_cancelled_is_passed_over():
    turns, release, made = Turns(RateLimit(0)), threading.Event(), []

    def make(number):
        assert release.wait(30)
        made.append(number)
        return number

    async def run():
        queues = [asyncio.Queue() for _ in range(4)]
        requests = [Request(scope("10.0.0.1"), queue.get) for queue in queues]
        tasks = [asyncio.create_task(turns.one(each, partial(make, n))) for n, each in enumerate(requests)]
        while turns._waiting.total() < 3:
            await asyncio.sleep(0)
        queues[1].put_nowait({"type": "http.disconnect"})
        tasks[2].cancel()
        release.set()
        return await asyncio.gather(*tasks, return_exceptions=True)

    results = run_apart(run(), 30)
    assert not turns._waiting
    assert not turns._lock.locked()
    assert (made, results[0], results[3]) == ([0, 3], 0, 3)
    assert isinstance(results[2], asyncio.CancelledError)


@dataclass
class Client:
    """Connections of one address."""

    address: str
    dropped: list[int] = field(default_factory=list)
    made: int = 0

    def place(self, evictable):
        number, self.made = self.made, self.made + 1
        return Place(self.address, lambda: evictable, lambda: self.dropped.append(number))


def test_the_oldest_connection_without_a_request_makes_room():
    all_, one = Places(4), Client("127.0.0.1")
    assert [all_.take(one.place(evictable)) for evictable in (False, True, True, False)] == [True] * 4
    assert all_.take(one.place(True))
    assert (one.dropped, all_.open, all_.dropped) == ([1], 4, {"evicted": 1, "refused": 0})


def test_a_place_is_refused_where_every_other_has_a_request():
    all_, one = Places(2), Client("127.0.0.1")
    first = one.place(False)
    assert [all_.take(each) for each in (first, one.place(False), one.place(True))] == [True, True, False]
    all_.free(first)
    all_.free(first)
    assert all_.take(one.place(True))
    assert (one.dropped, all_.open, all_.dropped["refused"]) == ([], 2, 1)


def test_one_client_has_half_of_all_places_except_on_loopback():
    all_, greedy, other = Places(8), Client("192.0.2.1"), Client("192.0.2.2")
    assert all_.take(other.place(True))
    assert all(all_.take(greedy.place(True)) for _ in range(9))
    assert (len(greedy.dropped), other.dropped, all_.open) == (5, [], 5)
    for loopback in ("127.0.0.1", "::1"):
        all_, proxy = Places(8), Client(loopback)
        assert all(all_.take(proxy.place(False)) for _ in range(8))


@pytest.mark.parametrize(
    ("streams", "descriptors", "limit"), [(256, 1024, 409), (256, 65536, 1024), (1000, 65536, 2000), (1, 256, 102)]
)
def test_the_number_of_places_follows_streams_and_descriptors(monkeypatch, streams, descriptors, limit):
    monkeypatch.setattr(connection_limit.resource, "getrlimit", lambda _: (descriptors, descriptors))
    assert connection_limit.limit(streams) == limit


def test_the_log_has_a_few_of_each_kind_a_minute_and_counts_the_others(caplog):
    now = 0.0
    log = logging.getLogger("tactiled.test_log_limit")
    log.addFilter(LogLimit(lambda: now))
    for n in range(MAX_A_MINUTE + 7):
        log.error(f"client 127.0.0.1:{n} is %s", "odd")
    log.error("another kind")
    assert caplog.messages[-2:] == [f"client 127.0.0.1:{MAX_A_MINUTE - 1} is odd", "another kind"]
    assert len(caplog.records) == MAX_A_MINUTE + 1
    now = 60.0
    log.error("client 127.0.0.1:99 is %s", "odd")
    assert caplog.records[-1].message == "client 127.0.0.1:99 is odd (7 like it were left out before)"


def test_changes_and_costly_answers_are_limited_apart_for_each_client(rig):
    rig.show(pressed())
    with running(rig.service, Server(port=0, control_per_minute=1)) as url:
        frames = f"{url}/api/v1/sensors/palm/frames"
        assert ask("GET", frames + "/deviation").status_code == 200
        assert ask("PUT", url + METHOD, json={"method": "raw"}).status_code == 200
        answer = ask("PUT", url + METHOD, json={"method": "nnls"})
        problem(answer, 429)
        assert 1 <= int(answer.headers["retry-after"]) <= 60
        for path in ("/raw?format=png", "/deviation", "?last=1s"):
            problem(ask("GET", frames + path), 429)
        assert {ask("GET", url + path).status_code for path in ("/api/v1/health", METHOD, "/") * 5} == {200}
    assert rig.sensor.method == "raw"


@pytest.mark.parametrize("path", ["/api/v1/stream", "/api/v1/sensors/palm/stream", "/xela", "/"])
def test_streams_are_limited_for_each_client_and_for_all_and_counted(rig, path):
    with running(rig.service, Server(port=0, streams_per_client=2, streams=3)) as url, ExitStack() as stack:

        def stream(host, path="/api/v1/stream"):
            headers = {"X-Forwarded-For": host}
            return stack.enter_context(connect(websocket_url(url, path), additional_headers=headers))

        streams = [stream(host) for host in ("10.0.0.1", "10.0.0.2", "10.0.0.1")]
        for each in streams:
            assert "status" in each.recv(timeout=BUSY_S)
        reason = "streams_per_client = 2: 10.0.0.1 has as many open: close one"
        assert closed(stream("10.0.0.1", path)) == (4429, reason)
        assert closed(stream("10.0.0.2", path)) == (4503, "streams = 3: as many are open: come again later")
        metrics = ask("GET", url + "/metrics").text.splitlines()
        assert "tactiled_streams 3.0" in metrics
        assert 'tactiled_streams_refused_total{bound="streams_per_client"} 1.0' in metrics
        assert 'tactiled_streams_refused_total{bound="streams"} 1.0' in metrics
        streams[0].close()
        until(lambda: "tactiled_streams 2" in ask("GET", url + "/metrics").text)
        assert "status" in stream("10.0.0.1").recv(timeout=BUSY_S)


def test_a_proxy_on_this_machine_names_its_clients(rig):
    """The proxy appends the last address; those before may be claims of the client."""
    with running(rig.service, Server(port=0, control_per_minute=1)) as url:
        hosts = "10.0.0.1", "10.0.0.2", "9.9.9.9, 10.0.0.1", "10.0.0.1, 10.0.0.3"
        headers = [{"X-Forwarded-For": host} for host in hosts]
        answers = [ask("PUT", url + METHOD, json={"method": "raw"}, headers=each) for each in headers]
        assert [each.status_code for each in answers] == [200, 200, 429, 200]
