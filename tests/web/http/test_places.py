from dataclasses import dataclass, field

import pytest

from tactiled.web.http import places
from tactiled.web.http.places import Place, Places, limit


@dataclass
class Client:
    """Connections of one address."""

    address: str
    dropped: list[int] = field(default_factory=list)
    made: int = 0

    def place(self, evictable):
        number, self.made = self.made, self.made + 1
        return Place(self.address, lambda: evictable, lambda: self.dropped.append(number))


def test_the_oldest_without_a_request_makes_room():
    all_, one = Places(4), Client("127.0.0.1")
    assert [all_.take(one.place(evictable)) for evictable in (False, True, True, False)] == [True] * 4
    assert all_.take(one.place(True))
    assert (one.dropped, all_.open, all_.dropped) == ([1], 4, {"evicted": 1, "refused": 0})


def test_a_place_is_refused_where_every_other_has_a_request():
    all_, one = Places(2), Client("127.0.0.1")
    kept = [one.place(False) for _ in range(2)]
    assert [all_.take(each) for each in kept] == [True, True]
    assert not all_.take(one.place(True))
    all_.free(kept[0])
    all_.free(kept[0])
    assert all_.take(one.place(True))
    assert (one.dropped, all_.open, all_.dropped["refused"]) == ([], 2, 1)


def test_one_client_takes_half_of_all_at_most_and_makes_room_itself():
    all_, greedy, other = Places(8), Client("192.0.2.1"), Client("192.0.2.2")
    assert all_.take(other.place(True))
    assert all(all_.take(greedy.place(True)) for _ in range(9))
    assert (len(greedy.dropped), other.dropped, all_.open) == (5, [], 5)


def test_loopback_may_be_a_proxy_that_speaks_for_many():
    all_, proxy = Places(8), Client("127.0.0.1")
    assert all(all_.take(proxy.place(False)) for _ in range(8))


@pytest.mark.parametrize(
    ("streams", "descriptors", "most"), [(256, 1024, 409), (256, 65536, 1024), (1000, 65536, 2000), (1, 256, 102)]
)
def test_the_limit_follows_streams_and_descriptors(monkeypatch, streams, descriptors, most):
    monkeypatch.setattr(places.resource, "getrlimit", lambda _: (descriptors, descriptors))
    assert limit(streams) == most
