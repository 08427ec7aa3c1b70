import asyncio
import math
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial

import pytest
from starlette.requests import Request

from tactiled.web.http import limits
from tactiled.web.http.limits import Rates, Streams, Turns, client
from tactiled.web.http.problems import Problem


@pytest.fixture
def now():
    return [0.0]


def test_a_client_may_ask_as_often_as_it_may_and_no_more(now):
    limit = Rates(60, lambda: now[0])
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
    limit, let = Rates(30, lambda: now[0]), 0
    for _ in range(36000):
        now[0] += 0.1
        let += limit.take("a") == 0
    assert abs(let - 1800) <= 6


def test_what_is_refused_says_when_to_come_again(now):
    limit = Rates(6, lambda: now[0])
    limit.count({"client": ("1.2.3.4", 1)})
    with pytest.raises(Problem) as caught:
        limit.count({"client": ("1.2.3.4", 2)})
    assert (caught.value.status_code, caught.value.headers) == (429, {"Retry-After": "10"})
    now[0] += math.nextafter(10, 20)
    limit.count({"client": ("1.2.3.4", 3)})


def test_no_bound_where_none_is_wanted(now):
    limit = Rates(0, lambda: now[0])
    assert {limit.take("a") for _ in range(10_000)} == {0.0}


def test_memory_is_bounded_whatever_the_number_of_clients(now, monkeypatch):
    monkeypatch.setattr(limits, "CLIENTS", 10)
    limit = Rates(6, lambda: now[0])
    for n in range(1000):
        limit.take(str(n))
    assert len(limit._buckets) == 10
    assert limit.take("999") > 0  # the newest are remembered


def test_one_network_is_one_client():
    def who(host):
        return client({"client": (host, 1)})

    assert who("2001:db8::1") == who("2001:db8::ffff:1") != who("2001:db8:0:1::1")
    assert who("fe80::1%eth0") == who("fe80::2%eth1")
    assert who("10.0.0.1") != who("10.0.0.2")
    assert client({"client": None}) == client({}) == ""


def test_what_is_no_address_takes_no_memory():
    assert client({"client": ("x" * 60_000, 0)}) == ""  # as a header of a proxy may say


def one(host):
    return {"client": (host, 1)}


def test_a_client_has_as_many_streams_as_it_may_until_one_ends():
    streams = Streams(2, 3)
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
    streams = Streams(1, 1)
    with pytest.raises(ZeroDivisionError), streams.one(one("10.0.0.1")):
        raise ZeroDivisionError
    with streams.one(one("10.0.0.1")):
        pass


def test_no_bound_on_streams_where_none_is_wanted():
    streams = Streams(0, 0)
    with ExitStack() as stack:
        for _ in range(1000):
            stack.enter_context(streams.one(one("10.0.0.1")))
        assert streams.open == 1000


def asked(host):
    return Request({"type": "http", "client": (host, 1)}, asyncio.Queue().get)


@pytest.mark.parametrize(
    ("took", "elapsed", "wait"), [((), 2.5, 8), ((3.0,), 0.5, 9), ((1.0, 2.0), 4.0, 12), ((), 0.0, 1)]
)
def test_who_finds_the_queue_full_is_told_how_long_it_will_take(now, monkeypatch, took, elapsed, wait):
    """One answer is made and two wait."""
    monkeypatch.setattr(limits, "MOST_WAITING", 2)
    turns, go_on = Turns(Rates(0), lambda: now[0]), threading.Event()

    def later(seconds):
        now[0] += seconds

    async def go():
        for each in took:
            await turns.one(asked("10.0.0.1"), partial(later, each))
        later(100)  # in which nobody asks
        waiting = [asyncio.create_task(turns.one(asked("10.0.0.1"), go_on.wait)) for _ in range(3)]
        while turns._waiting.total() < 2:
            await asyncio.sleep(0)
        later(elapsed)
        with pytest.raises(Problem) as caught:
            await turns.one(asked("10.0.0.2"), go_on.wait)
        go_on.set()
        await asyncio.gather(*waiting)
        assert not turns._waiting  # who has none is forgotten
        return caught.value

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        refused = other.submit(asyncio.run, go()).result(30)
    assert (refused.status_code, refused.headers) == (429, {"Retry-After": str(wait)})


def test_who_leaves_amid_the_queue_takes_nobodys_turn():
    turns, go_on, made = Turns(Rates(0)), threading.Event(), []

    def make(number):
        assert go_on.wait(30)
        made.append(number)
        return number

    async def go():
        requests = [asked("10.0.0.1") for _ in range(4)]
        gone = asyncio.Queue()
        requests[1] = Request({"type": "http", "client": ("10.0.0.1", 1)}, gone.get)
        tasks = [
            asyncio.create_task(turns.one(each, partial(make, number))) for number, each in enumerate(requests)
        ]
        while turns._waiting.total() < 3:
            await asyncio.sleep(0)
        gone.put_nowait({"type": "http.request"})
        gone.put_nowait({"type": "http.disconnect"})
        try:
            await asyncio.wait_for(tasks[1], 10)
            assert turns._waiting == {"10.0.0.1": 2}
        finally:
            go_on.set()
        return await asyncio.gather(*tasks)

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        answers = other.submit(asyncio.run, go()).result(30)
    assert made == [0, 2, 3]
    assert [*answers[:1], *answers[2:]] == [0, 2, 3]


def test_who_comes_between_two_turns_and_leaves_gives_its_place_back_at_once():
    turns, go_on, gone = Turns(Rates(0)), threading.Event(), asyncio.Queue()

    async def go():
        await turns._lock.acquire()
        next_ = asyncio.create_task(turns.one(asked("10.0.0.1"), partial(go_on.wait, 30)))
        while not turns._lock._waiters:
            await asyncio.sleep(0)
        late = Request({"type": "http", "client": ("10.0.0.2", 1)}, gone.get)
        turns._lock.release()  # and the next one has not taken it up yet
        try:
            gone.put_nowait({"type": "http.disconnect"})
            async with asyncio.timeout(10):  # no task of its own, which would come too late
                await turns.one(late, partial(pytest.fail, "made for nobody"))
            assert not turns._waiting["10.0.0.2"]
        finally:
            go_on.set()
        return await next_

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        assert other.submit(asyncio.run, go()).result(30)


def test_a_wait_that_is_ended_from_outside_leaves_the_queue_as_it_was():
    turns, go_on = Turns(Rates(0)), threading.Event()

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


def test_what_is_wrong_with_the_body_of_one_that_waits_is_told():
    turns, go_on = Turns(Rates(0)), threading.Event()

    async def large():
        raise Problem(413, "too large")

    async def go():
        first = asyncio.create_task(turns.one(asked("10.0.0.1"), go_on.wait))
        await asyncio.sleep(0)
        try:
            with pytest.raises(Problem, match="too large"):
                await turns.one(Request({"type": "http", "client": ("10.0.0.2", 1)}, large), go_on.wait)
        finally:
            go_on.set()
        return await first

    with ThreadPoolExecutor(1) as other:
        assert other.submit(asyncio.run, go()).result(30)
    assert not turns._lock.locked()
