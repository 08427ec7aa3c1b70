import pytest

from tests.bench import bus


@pytest.mark.parametrize(("buses", "messages"), [(1, 2000), (3, 2001)])
def test_every_message_that_is_sent_is_received_and_counted(request, buses, messages):
    channels = [{"interface": "virtual", "channel": f"{request.node.name}{n}"} for n in range(buses)]
    result = bus.live(channels, rate=20_000, seconds=0.1)
    assert (result.messages, result.received, result.lost) == (messages, messages, 0)
    assert result.rate > 0


def test_every_codec_is_measured_both_ways():
    results = list(bus.offline(0.05))
    assert [name for name, *_ in results] == list(bus.SKINS)
    assert all(min(received, encoded) > 0 for *_, received, encoded in results)
