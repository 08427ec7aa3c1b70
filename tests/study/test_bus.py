import pytest

from tests.study import bus


@pytest.mark.parametrize(("count", "sent"), [(1, 2000), (3, 2001)])
def test_every_message_that_is_sent_is_received_and_counted(request, count, sent):
    buses = [{"interface": "virtual", "channel": f"{request.node.name}{n}"} for n in range(count)]
    result = bus.live(buses, rate=20_000, seconds=0.1)
    assert (result.sent, result.received, result.lost) == (sent, sent, 0)
    assert result.rate > 0


def test_every_codec_is_measured_both_ways():
    results = list(bus.offline(0.05))
    assert [name for name, *_ in results] == list(bus.SKINS)
    assert all(min(received, encoded) > 0 for *_, received, encoded in results)
