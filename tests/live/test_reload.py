import threading
import time

import numpy as np
import pytest

from tactiled.bus.reader import open_bus
from tactiled.config import load
from tactiled.errors import ConfigError, ReloadError, TactileError
from tactiled.live.reload import new_plans
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.live.state_file import StateFile
from tests.conftest import CONFIG, NO_LOAD, pressed, until

BUS = '\n[bus.{name}]\ninterface = "virtual"\nchannel = "{channel}"\n'
PALM = CONFIG.partition("[sensor.palm]")[2].replace("{{", "{").replace("}}", "}")
PALM = PALM.replace("stale_after_s = 0.3", "stale_after_s = 600")  # however slow a machine sends frames


class Live:
    """A service that runs by a file, and the other ends of its buses."""

    def __init__(self, folder, channel):
        self.path, self.channel, self.sequence = folder / "palm.toml", channel, 0
        self.ends = {}
        self.write(palm=1, thumb=2)
        self.service = Service(load(self.path), state=StateFile(folder / "state.json"), path=self.path)
        self.service.start()

    def write(self, server="", buses=("can0",), change=("", ""), **ids):
        """Write the file: sensors by array id, each on the bus can0, or as `name: (bus, id)`."""
        text = f"[server]\n{server}\n"
        for bus in buses:
            text += BUS.format(name=bus, channel=f"{self.channel}-{bus}")
        for name, at in ids.items():
            bus, number = at if isinstance(at, tuple) else ("can0", at)
            palm = PALM.replace('"packed"', f'"packed", array_id = {number}').replace('"can0"', f'"{bus}"')
            text += f"\n[sensor.{name}]{palm}"
        self.path.write_text(text.replace(*change, 1) if change[0] else text)

    def show(self, *names, counts=None):
        """Send a frame of each sensor and wait for its image."""
        counts = np.asarray(pressed() if counts is None else counts, np.uint16).ravel()
        for name in names or self.service.sensors:
            sensor = self.service.sensor(name)
            before = sensor.hub.latest()
            for message in sensor.codec.encode(counts, self.sequence, time.time()):
                self.end(sensor).send(message)
            until(lambda sensor=sensor, before=before: sensor.hub.latest() is not before)
        self.sequence += 1

    def end(self, sensor):
        """The other end of a sensor's bus."""
        channel = self.service.buses[sensor.plan.bus]["channel"]
        if channel not in self.ends:
            self.ends[channel] = open_bus("virtual", channel=channel)
        return self.ends[channel]

    def kinds(self):
        return [each.kind for each in self.service.events.after(0)]

    def close(self):
        self.service.stop()
        for each in self.ends.values():
            each.close()


@pytest.fixture
def live(tmp_path, request):
    made = Live(tmp_path, request.node.name)
    yield made
    made.close()


def names(changes):
    return changes.added, changes.removed, changes.restarted, changes.unchanged


def everything(live):
    """What must be the same after a reload that is refused."""
    service = live.service
    return service.config, service.sensors, dict(service.buses), dict(service._sources), service._watch.sensors


def test_only_what_changed_restarts_and_the_rest_keeps_all(live):
    live.show()
    palm, thumb = live.service.sensors.values()
    live.service.set_method("palm", "raw")
    palm.tare(force=True)
    while not palm.pipeline.tares.done:
        live.show("palm")
    kept = palm.pipeline, palm.pipeline.zero, palm.method, palm.history
    live.write(palm=1, tip=3, index=("can1", 4), buses=("can0", "can1"))
    outcome = live.service.reload()
    assert names(outcome.sensors) == (("tip", "index"), ("thumb",), (), ("palm",))
    assert names(outcome.buses) == (("can1",), (), (), ("can0",))
    assert list(live.service.sensors) == ["palm", "tip", "index"]
    live.show()
    assert live.service.sensors["palm"] is palm
    assert (palm.pipeline, palm.pipeline.zero, palm.method, palm.history) == kept
    assert thumb.status().detail == "is no longer in the configuration"
    assert not thumb.hand_over._thread.is_alive()
    live.write(palm=1)
    live.service.reload()
    assert (list(live.service.sensors), list(live.service.buses)) == (["palm"], ["can0"])
    live.show("palm")


def test_no_frame_of_an_unchanged_sensor_is_lost_whatever_comes_and_goes_beside_it(live):
    palm, received, stop = live.service.sensor("palm"), [], threading.Event()
    palm.frames.subscribe(lambda frame: received.append(frame.sequence))
    end = live.end(palm)

    def send():
        sequence = 0
        while not stop.wait(0.002):
            for message in palm.codec.encode(np.full(64, NO_LOAD, np.uint16), sequence, time.time()):
                end.send(message)
            sequence += 1

    sender = threading.Thread(target=send)
    sender.start()
    for n, others in enumerate(({"thumb": 3}, {}, {"tip": 2}, {"tip": 4, "thumb": ("can1", 2)})):
        until(lambda n=n: len(received) > 20 * n)
        live.write(palm=1, buses=("can0", "can1"), **others)
        assert "palm" in live.service.reload().sensors.unchanged
    count = len(received)
    until(lambda: len(received) > count + 5)
    stop.set()
    sender.join()
    assert received == list(range(len(received)))
    assert palm.status().loss.lost == palm.status().loss.incomplete == 0


def test_a_sensor_that_comes_shows_at_once_what_its_bus_has_counted(live, monkeypatch):
    bus, start, seen = live.service._sources["can0"], Sensor.start, []
    bus._kinds["bus_off"] = bus._counts["bus_off"] = 2
    monkeypatch.setattr(Sensor, "start", lambda sensor: (seen.append(sensor.status()), start(sensor)))
    live.write(palm=1, tip=3)
    live.service.reload()
    assert [(each.errors["bus_off"], each.loss.bus_off) for each in seen] == [(2, 2)]


def test_a_sensor_that_changed_restarts_with_what_is_kept_of_it(live):
    live.show()
    before = live.service.sensor("palm")
    live.service.set_method("palm", "raw", keep=True)
    before.tare(force=True)
    while not before.pipeline.tares.done:
        live.show("palm")
    until(lambda: "tare_done" in live.kinds())
    live.write(palm=1, thumb=2, change=("pitch_mm = 1.0", "pitch_mm = 2.0"))
    assert names(live.service.reload().sensors) == ((), (), ("palm",), ("thumb",))
    palm = live.service.sensor("palm")
    assert palm is not before
    assert (palm.array.pitch, palm.method, palm.hub.latest()) == (2.0, "raw", None)
    assert palm.pipeline.zero.time == before.pipeline.zero.time
    live.show()
    until(lambda: live.service._watch._watched == live.service._watch.sensors)  # it has looked at the new one
    kinds = [each for each in live.kinds() if not each.startswith(("sensor", "warning"))]
    assert kinds == ["method_set", "tare_done", "method_kept", "tare_kept", "config_reloaded"]


def test_a_calibration_file_that_changed_restarts_its_sensor(live, tmp_path):
    change = "noise_kpa = 0.5", 'file = "palm.json", dead = [3]'
    live.write(palm=1, change=change)
    live.service.reload()
    assert live.kinds()[-2:] == ["calibration_missing", "config_reloaded"]
    assert live.service.reload().sensors.unchanged == ("palm",)
    (tmp_path / "palm.json").write_text("{")
    with pytest.raises(ConfigError, match=r"sensor\.palm: .*palm\.json"):
        live.service.reload()


def test_a_bus_that_changed_restarts_with_its_sensors(live):
    live.write(palm=1, thumb=("can1", 2), buses=("can0", "can1"))
    live.service.reload()
    live.channel += "-new"
    live.write(palm=1, thumb=("can1", 2), buses=("can0", "can1"))
    outcome = live.service.reload()
    assert names(outcome.buses) == ((), (), ("can0", "can1"), ())
    assert names(outcome.sensors) == ((), (), ("palm", "thumb"), ())
    live.show()


LINES = {
    "no TOML": ("[bus.can0]", "[bus.can0", "palm.toml: not TOML: "),
    "unknown key": ("stale_after_s", "stale_after_ms", "palm.toml: sensor.palm.stale_after_ms: unknown key"),
    "bad value": ("pitch_mm = 1.0", "pitch_mm = -1.0", "palm.toml: sensor.palm.array.pitch_mm = -1.0: "),
    "two sensors of one id": ("array_id = 2", "array_id = 1", "sensors palm and thumb both listen to id "),
    "a kernel that nobody measured": ('"layered"', '"measured"', 'sensor.palm: kernel.model = "measured": '),
    "port": ("[server]", "[server]\nport = 8001", "server.port = 8001: cannot change while the service runs: re"),
    "token": ("[server]", '[server]\ncontrol_token = "hush-hush-hush-1"', "server.control_token: cannot change"),
    "a bus that cannot be opened": ('"virtual"', '"slcan"', "bus slcan "),
}


@pytest.mark.parametrize(("old", "new", "line"), LINES.values(), ids=LINES)
def test_a_wrong_file_changes_nothing_and_says_why_in_a_line(live, caplog, old, new, line):
    live.show()
    before = everything(live)
    live.write(palm=1, thumb=2, change=(old, new))
    with pytest.raises(TactileError) as caught:
        live.service.reload()
    assert line in str(caught.value)
    assert "hush" not in caplog.text + str(caught.value)
    assert any(each.kind == "config_refused" and line in each.text for each in live.service.events.after(0))
    assert line in caplog.text
    assert everything(live) == before
    live.show()  # all of it runs as before
    assert {each.status().loss.lost for each in live.service.sensors.values()} == {0}


def test_two_reloads_at_once_come_one_after_the_other(live, monkeypatch):
    running, largest = [0], [0]

    def slowly(*arguments):
        running[0] += 1
        largest[0] = max(largest[0], running[0])
        time.sleep(0.05)
        running[0] -= 1
        return new_plans(*arguments)

    monkeypatch.setattr("tactiled.live.service.new_plans", slowly)
    live.write(palm=1, tip=3)
    outcomes = [each.result().sensors for each in [live.service.start_reload() for _ in range(3)]]
    assert largest == [1]
    assert sorted(map(names, outcomes))[-1] == (("tip",), ("thumb",), (), ("palm",))
    assert [each.added for each in outcomes].count(("tip",)) == 1


def test_a_service_that_ends_meanwhile_starts_nothing_more(live, monkeypatch):
    def late(*arguments):
        live.service.stop()
        return new_plans(*arguments)

    monkeypatch.setattr("tactiled.live.service.new_plans", late)
    threads = {each.name for each in threading.enumerate()}
    live.write(palm=1, tip=3)
    with pytest.raises(ReloadError, match="the service ends"):
        live.service.reload()
    assert {each.name for each in threading.enumerate()} <= threads
