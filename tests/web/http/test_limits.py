import asyncio
import math
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial

import pytest
from starlette.requests import Request

from tactiled.web.http import limits
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit, Turns, client_of
from tactiled.web.http.problems import Problem


@pytest.fixture
def now():
    return [0.0]


def test_a_client_may_ask_as_often_as_it_may_and_no_more(now):
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


def test_over_an_hour_it_is_what_is_configured(now):
    limit, let = RateLimit(30, lambda: now[0]), 0
    for _ in range(36000):
        now[0] += 0.1
        let += limit.take("a") == 0
    assert abs(let - 1800) <= 6


def test_what_is_refused_says_when_to_come_again(now):
    limit = RateLimit(6, lambda: now[0])
    limit.count({"client": ("1.2.3.4", 1)})
    with pytest.raises(Problem) as caught:
        limit.count({"client": ("1.2.3.4", 2)})
    assert (caught.value.status_code, caught.value.headers) == (429, {"Retry-After": "10"})
    now[0] += math.nextafter(10, 20)
    limit.count({"client": ("1.2.3.4", 3)})


def test_no_bound_where_none_is_wanted(now):
    limit = RateLimit(0, lambda: now[0])
    assert {limit.take("a") for _ in range(10_000)} == {0.0}


def test_memory_is_bounded_whatever_the_number_of_clients(now, monkeypatch):
    monkeypatch.setattr(limits, "MAX_CLIENTS", 10)
    limit = RateLimit(6, lambda: now[0])
    for n in range(1000):
        limit.take(str(n))
    assert len(limit._buckets) == 10
    assert limit.take("999") > 0  # the newest are remembered


def test_one_network_is_one_client():
    def who(host):
        return client_of({"client": (host, 1)})

    assert who("2001:db8::1") == who("2001:db8::ffff:1") != who("2001:db8:0:1::1")
    assert who("fe80::1%eth0") == who("fe80::2%eth1")
    assert who("10.0.0.1") != who("10.0.0.2")
    assert client_of({"client": None}) == client_of({}) == ""


def test_what_is_no_address_takes_no_memory():
    assert client_of({"client": ("x" * 60_000, 0)}) == ""  # as a header of a proxy may say


def one(host):
    return {"client": (host, 1)}


def test_a_client_has_as_many_streams_as_it_may_until_one_ends():
    streams = ConcurrencyLimit(2, 3)
    with streams.one(one("a::1")), streams.one(one("10.0.0.1")):
        with streams.one(one("a::2")):
            assert streams.open == 3
            for host, status in (("a::3", 429), ("10.0.0.1", 503), ("10.0.0.2", 503)):
                with pytest.raises(Problem) as caught, streams.one(one(host)):
                    pass
                assert caught.value.status_code == status
        with streams.one(one("a::3")):
            assert streams.open == 3
    assert streams.open == 0
    assert len(streams._open) == 0  # who has none is forgotten
    assert streams.refused == {"streams_per_client": 1, "streams": 2}


def test_a_stream_that_fails_gives_its_place_back():
    streams = ConcurrencyLimit(1, 1)
    with pytest.raises(ZeroDivisionError), streams.one(one("10.0.0.1")):
        raise ZeroDivisionError
    with streams.one(one("10.0.0.1")):
        pass


def test_no_bound_on_streams_where_none_is_wanted():
    streams = ConcurrencyLimit(0, 0)
    with ExitStack() as stack:
        for _ in range(1000):
            stack.enter_context(streams.one(one("10.0.0.1")))
        assert streams.open == 1000


def asked(host):
    return Request({"type": "http", "client": (host, 1)}, asyncio.Queue().get)


def test_a_client_that_left_is_passed_over():
    turns, go_on, made = Turns(RateLimit(0)), threading.Event(), []

    def make(number):
        assert go_on.wait(30)
        made.append(number)
        return number

    async def go():
        requests = [asked("10.0.0.1") for _ in range(4)]
        disconnected = asyncio.Queue()
        disconnected.put_nowait({"type": "http.disconnect"})
        requests[1] = Request({"type": "http", "client": ("10.0.0.1", 1)}, disconnected.get)
        tasks = [
            asyncio.create_task(turns.one(each, partial(make, number))) for number, each in enumerate(requests)
        ]
        while turns._waiting.total() < 3:
            await asyncio.sleep(0)
        go_on.set()
        return await asyncio.gather(*tasks)

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        answers = other.submit(asyncio.run, go()).result(30)
    assert made == [0, 2, 3]
    assert [*answers[:1], *answers[2:]] == [0, 2, 3]
    assert not turns._waiting


def test_a_wait_that_is_ended_from_outside_leaves_the_queue_as_it_was():
    turns, go_on = Turns(RateLimit(0)), threading.Event()

    async def go():
        tasks = [asyncio.create_task(turns.one(asked("10.0.0.1"), go_on.wait)) for _ in range(3)]
        while turns._waiting.total() < 2:
            await asyncio.sleep(0)
        tasks[1].cancel()
        go_on.set()
        return await asyncio.gather(*tasks, return_exceptions=True)

    with ThreadPoolExecutor(1) as other:
        first, ended, last = other.submit(asyncio.run, go()).result(30)
    assert (first, last) == (True, True)
    assert isinstance(ended, asyncio.CancelledError)
    assert not turns._waiting
    assert not turns._lock.locked()
