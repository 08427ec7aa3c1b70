"""Streams of a service whose configuration is reloaded."""

import pytest

from tests.conftest import CONFIG, pressed
from tests.skin import TIP
from tests.web.ws.clients import NEXT, ONE, SEVERAL, closed, images, stream, text
from tests.web.ws.test_streams import rig, show  # noqa: F401  # the palm and the tip

THUMB = TIP.replace("tip", "thumb").replace("array_id = 1", "array_id = 2")
REMOVED = "is no longer in the configuration"


@pytest.fixture
def reload(rig, tmp_path):  # noqa: F811
    rig.service.path = tmp_path / "rig.toml"

    def write(*others, change=("", "")):
        palm = CONFIG.format(channel=rig.config.bus["can0"].channel).replace(*change)
        rig.service.path.write_text(palm + "".join(others))
        return rig.service.reload()

    return write


def test_a_stream_of_all_goes_on_with_the_sensors_that_there_are(rig, url, reload):  # noqa: F811
    with stream(url, "?flow=credit&kinds=raw", SEVERAL) as client:
        text(client, lambda each: each["sensor"] == "tip")
        client.send(NEXT)
        reload(THUMB)
        last = text(client, lambda each: (each["sensor"], each["state"]) == ("tip", "down"))
        assert last["detail"] == REMOVED
        text(client, lambda each: each["sensor"] == "thumb")
        client.send('{"type": "next", "sensor": "thumb"}')
        client.send('{"type": "next", "sensor": "tip"}')  # under way when it was removed
        for name in ("palm", "thumb"):
            show(rig, name)
            assert [each.sensor for each in images(client, 1)] == [name]
        reload(THUMB, TIP)
        text(client, lambda each: (each["sensor"], each["state"]) == ("tip", "silent"))
        show(rig, "tip")
        assert images(client, 1)[0].sensor == "tip"  # what was requested of it before comes


def test_a_stream_of_sensors_that_are_all_removed_is_closed(rig, url, reload):  # noqa: F811
    with (
        stream(url, path=ONE.replace("palm", "tip")) as one,
        stream(url, "?sensors=tip", SEVERAL) as named,
        stream(url, "?sensors=palm,tip&kinds=raw", SEVERAL) as both,
    ):
        text(one)
        reload()
        assert closed(one) == closed(named) == (4410, "tip: no longer in the configuration")
        rig.show(pressed())
        assert images(both, 1)[0].sensor == "palm"


def test_a_stream_of_a_sensor_that_restarts_goes_on_in_its_new_shape(rig, url, reload):  # noqa: F811
    with stream(url, "?kinds=restored") as client:
        rig.show(pressed())
        assert images(client, 1)[0].values.shape == (8, 8)
        reload(TIP, change=('method = "wiener"', 'method = "raw"\nrefine = 2'))
        text(client, lambda each: each["state"] == "silent")
        show(rig, "palm")
        image = images(client, 1)[0]
        assert (image.sequence, image.values.shape) == (0, (16, 16))
