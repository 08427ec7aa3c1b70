"""Bridges of other packages."""

import sys

import pytest

from tactiled.config import Server
from tactiled.errors import ConfigError
from tactiled.interop.bridges import configured
from tests.conftest import ask, pressed, until

BRIDGE = """
from tactiled.web.bridge import Bridge

class Lines(Bridge):
    name = "lines"
    def start(self, host):
        self.lines = []
        return "lines of my own"
    def enter(self, sensor):
        self.lines.append(("enter", sensor.name))
    def on_image(self, sensor, image):
        self.lines.append(("image", image.sequence))
        if image.sequence == 1:
            raise ZeroDivisionError("by zero")
        return image.sequence != 2 or len(self.lines) > 6
    def on_status(self, sensor, now):
        if self.lines[-1] != ("status", sensor.state):
            self.lines.append(("status", sensor.state))
    def stop(self):
        self.lines.append(("stop", ""))

def fails():
    raise OSError("no device")
"""


@pytest.fixture
def packages(tmp_path, monkeypatch):
    (tmp_path / "their_bridge.py").write_text(BRIDGE)
    about = tmp_path / "their_bridge-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-bridge\nVersion: 1\n")
    offers = "".join(f"{name} = their_bridge:{what}\n" for name, what in (("lines", "Lines"), ("broken", "fails")))
    (about / "entry_points.txt").write_text(f"[tactiled.bridges]\n{offers}none = builtins:dict\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("their_bridge", None)


@pytest.mark.usefixtures("packages")
def test_a_bridge_of_another_package_gets_images_and_states_and_its_faults_are_the_services(rig, url):
    *_, bridge = configured(Server(bridges=("lines",)))
    faults = {"lines of palm": "ZeroDivisionError: by zero"}
    with bridge.running(rig.host) as where:
        assert where == "lines of my own"
        until(lambda: bridge.lines == [("enter", "palm"), ("status", "silent")])
        rig.show(pressed())
        until(lambda: ("status", "live") in bridge.lines)
        rig.show(pressed())
        until(lambda: ("image", 1) in bridge.lines)
        until(lambda: ask("GET", f"{url}/api/v1/health").json()["faults"] == faults)
        rig.show(pressed())  # is offered until it is taken
        until(lambda: bridge.lines.count(("image", 2)) > 1)
    assert bridge.lines[-1] == ("stop", "")


@pytest.mark.usefixtures("packages")
def test_a_bridge_that_cannot_be_had_is_one_line():
    for name, why in (
        ("other", "offered by 0 packages; there are broken, lines, none"),
        ("broken", "fails: OSError: no device"),
        ("none", "is no tactiled.web.bridge.Bridge"),
    ):
        with pytest.raises(ConfigError, match=f"server.bridges: '{name}': {why}"):
            configured(Server(bridges=(name,)))
