from tests.bench import bus


def test_every_message_that_is_sent_is_received_and_counted(request):
    result = bus.live(request.node.name, 2000, 20_000)
    assert (result.received, result.lost) == (2000, 0)
    assert result.rate > 0


def test_every_codec_is_measured_both_ways():
    results = list(bus.offline(0.05))
    assert [name for name, *_ in results] == list(bus.SKINS)
    assert all(min(received, encoded) > 0 for *_, received, encoded in results)
