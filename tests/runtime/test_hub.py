from tactiled.runtime.hub import Hub


def test_newest_wins_and_every_listener_hears():
    hub, first, second = Hub(), [], []
    assert hub.latest() is None
    stop = hub.subscribe(first.append)
    hub.subscribe(second.append)
    one, two = object(), object()
    hub.publish(one)
    stop()
    hub.publish(two)
    assert hub.latest() is two
    assert first == [one]
    assert second == [one, two]


def test_stopping_twice_is_harmless():
    hub, heard = Hub(), []
    stop = hub.subscribe(heard.append)
    stop()
    stop()
    hub.publish(object())
    assert heard == []
