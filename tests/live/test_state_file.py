import json
import threading
from pathlib import Path
from unittest.mock import Mock

import pytest

from tactiled.config import parse
from tactiled.errors import ConfigError, StateError
from tactiled.live.service import Service
from tactiled.live.state_file import StateFile, default_path
from tests.conftest import CONFIG


@pytest.fixture
def path(tmp_path):
    return tmp_path / "deep" / "state.json"


def service(path, method="wiener"):
    return Service(parse(CONFIG.format(channel="none").replace("wiener", method)), state=StateFile(path))


def texts(service):
    return [(each.kind, each.sensor, each.text) for each in service.events.after(0)]


def test_a_kept_method_outlives_a_restart_and_another_does_not(path):
    first = service(path)
    assert texts(first) == []
    first.set_method("palm", "nnls", keep=True)
    first.set_method("palm", "raw")
    assert first.sensor("palm").method == "raw"
    again = service(path)
    assert again.sensor("palm").method == "nnls"
    assert texts(again) == [("method_kept", "palm", "nnls, where the configuration says wiener")]
    again.set_method("palm", "wiener", keep=True)  # as configured: the file has no method
    assert json.loads(path.read_text())["methods"] == {}
    assert service(path, "rl").sensor("palm").method == "rl"


def test_the_kept_method_is_the_one_that_runs_when_two_clients_set_at_once(path, monkeypatch):
    palm, keep = service(path), StateFile.keep
    other = threading.Thread(target=palm.set_method, args=("palm", "raw", True))

    def keep_slowly(state, sensor, method):
        keep(state, sensor, method)
        if method == "nnls":
            other.start()
            other.join(0.5)

    monkeypatch.setattr(StateFile, "keep", keep_slowly)
    palm.set_method("palm", "nnls", keep=True)
    other.join()
    assert (palm.sensor("palm").method, palm.state.methods["palm"]) == ("raw", "raw")


def test_a_kept_method_that_no_longer_applies_is_an_event(path):
    path.parent.mkdir()
    path.write_text(json.dumps({"version": 1, "methods": {"thumb": "raw", "palm": "sharpen"}}))
    palm = service(path)
    assert palm.sensor("palm").method == "wiener"
    assert texts(palm) == [
        ("state_ignored", None, "sensor thumb, method raw: no longer there"),
        ("state_ignored", None, "sensor palm, method sharpen: no longer there"),
    ]


@pytest.mark.parametrize(
    "text", ["", "[" * 100_000, "[]", '{"version": 2, "methods": {}}', '{"version": 1, "methods": {"a": 1}}']
)
def test_a_file_that_is_no_state_is_refused_by_name(path, text):
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"state {path}: .*delete it"):
        StateFile(path)


@pytest.mark.parametrize("fails", ["os.fsync", "pathlib.Path.replace"])
def test_a_state_that_cannot_be_written_changes_nothing(path, monkeypatch, fails):
    palm = service(path)
    palm.set_method("palm", "nnls", keep=True)
    before = path.read_bytes()
    monkeypatch.setattr(fails, Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(StateError, match="No space left on device: nothing was kept"):
        palm.set_method("palm", "raw", keep=True)
    assert (palm.sensor("palm").method, palm.state.methods) == ("nnls", {"palm": "nnls"})
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_second_service_with_the_same_file_does_not_start(path):
    error = pytest.raises(ConfigError, match=f"state {path}: another service runs with it")
    with service(path).running(), error, service(path).running():
        pass
    with service(path).running():
        pass


def test_every_configuration_has_a_default_state_file_of_its_own(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    one, other = default_path(Path("a/palm.toml")), default_path(Path("b/palm.toml"))
    assert one.parent == other.parent == tmp_path / "tactiled"
    assert one != other
    assert one == default_path(Path("a/../a/palm.toml"))
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "home", Mock(side_effect=RuntimeError("no home")))
    with pytest.raises(ConfigError, match=r"there is no home directory: set server\.state, HOME"):
        default_path(Path("palm.toml"))
