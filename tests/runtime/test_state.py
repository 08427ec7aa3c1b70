import json
import threading
from pathlib import Path

import pytest

from tactiled.config import parse
from tactiled.errors import ConfigError, StateError
from tactiled.runtime.service import Service
from tactiled.runtime.state import State, default
from tests.conftest import CONFIG


@pytest.fixture
def path(tmp_path):
    return tmp_path / "deep" / "state.json"


def service(path, method="wiener"):
    return Service(parse(CONFIG.format(channel="none").replace("wiener", method)), state=State(path))


def texts(service):
    return [(each.kind, each.sensor, each.text) for each in service.events.after(0)]


def test_a_method_that_is_kept_outlives_a_restart_and_one_that_is_not_does_not(path):
    first = service(path)
    assert texts(first) == []
    first.set_method("palm", "nnls", keep=True)
    first.set_method("palm", "raw")
    assert first.sensor("palm").method == "raw"
    again = service(path)
    assert again.sensor("palm").method == "nnls"
    assert texts(again) == [("method_kept", "palm", "nnls, where the configuration says wiener")]
    again.set_method("palm", "wiener", keep=True)  # as configured: nothing is left to keep
    assert json.loads(path.read_text())["methods"] == {}
    assert service(path, "rl").sensor("palm").method == "rl"


def test_what_is_kept_is_what_runs_whoever_asks_at_once(path, monkeypatch):
    found, keep = service(path), State.keep
    other = threading.Thread(target=found.set_method, args=("palm", "raw", True))

    def slowly(state, sensor, method):
        keep(state, sensor, method)
        if method == "nnls":
            other.start()
            other.join(0.5)

    monkeypatch.setattr(State, "keep", slowly)
    found.set_method("palm", "nnls", keep=True)
    other.join()
    assert (found.sensor("palm").method, found.state.methods["palm"]) == ("raw", "raw")


def test_what_no_longer_means_anything_is_told_and_not_applied(path):
    path.parent.mkdir()
    path.write_text(json.dumps({"version": 1, "methods": {"thumb": "raw", "palm": "sharpen"}}))
    found = service(path)
    assert found.sensor("palm").method == "wiener"
    assert texts(found) == [
        ("state_ignored", None, "sensor thumb, method raw: no longer there"),
        ("state_ignored", None, "sensor palm, method sharpen: no longer there"),
    ]


@pytest.mark.parametrize(
    "text", ["", "{", "[" * 100_000, "[]", '{"version": 2, "methods": {}}', '{"version": 1, "methods": {"a": 1}}']
)
def test_a_file_that_is_no_state_is_refused_by_name(path, text):
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"state {path}: .*delete it"):
        State(path)


@pytest.mark.parametrize("fails", ["os.fsync", "pathlib.Path.replace"])
def test_what_cannot_be_written_changes_nothing(path, monkeypatch, fails):
    found = service(path)
    found.set_method("palm", "nnls", keep=True)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(fails, full)
    with pytest.raises(StateError, match="No space left on device: nothing was kept"):
        found.set_method("palm", "raw", keep=True)
    assert found.sensor("palm").method == "nnls"
    assert found.state.methods == {"palm": "nnls"}
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(
        ConfigError, match=r"server\.state is missing and there is no home directory: set server\.s"
    ):
        default(Path("palm.toml"))


def test_every_configuration_has_a_state_file_of_its_own(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    one, other = default(Path("a/palm.toml")), default(Path("b/palm.toml"))
    assert one.parent == other.parent == tmp_path / "tactiled"
    assert one != other
    assert one == default(Path("a/../a/palm.toml"))
