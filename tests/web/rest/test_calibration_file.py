"""The calibration file over REST: download, upload, history; and the tare's undo."""

import time
from unittest.mock import Mock

import pytest

from tactiled.calibrate.calibration_file import load
from tactiled.config import parse
from tactiled.errors import ConfigError
from tactiled.live.service import Service
from tactiled.web.rest import calibration_file as calibration_file_over_rest
from tactiled.web.server import running
from tests.calibrate.files import CREATED, calibration_file
from tests.conftest import CONFIG, ask, pressed, problem

SCALARS = "kpa_per_count = 0.5, no_load = 100, "
ORIGIN = {"recording": "steps.log", "sha256": "5" * 64, "method": "steps", "created": CREATED}


@pytest.fixture
def palm(tmp_path):
    """The address of the palm's calibration, whose file is beside its configuration."""
    text = CONFIG.format(channel="none").replace(SCALARS, 'file = "palm.json", ')
    with running(Service(parse(text, folder=tmp_path))) as url:
        yield url + "/api/v1/sensors/palm/calibration"


def test_an_uploaded_file_applies_is_downloaded_again_and_is_in_the_history(palm, tmp_path):
    file, other = calibration_file(), calibration_file(gain=calibration_file().gain)
    assert problem(ask("GET", f"{palm}/file"), 404) == "sensor 'palm': no calibration file is in force"
    before = ask("GET", palm).json()
    keys = ("id", "created", "sections", "unit")
    assert [before[key] for key in keys] == ["configured", None, {}, "counts"]
    after = ask("PUT", f"{palm}/file", content=file.text).json()
    assert after == ask("GET", palm).json()
    assert (after["id"], after["created"], after["unit"], after["dead"]) == (file.id, CREATED, "kPa", [3])
    assert after["sections"].keys() == {"no_load", "gain", "cover", "health"}
    assert after["sections"]["gain"] == ORIGIN
    download = ask("GET", f"{palm}/file")
    assert download.text == file.text
    assert download.headers["content-type"] == "application/vnd.tactiled.calibration+json"
    assert 'filename="palm.json"' in download.headers["content-disposition"]
    ask("PUT", f"{palm}/file", content=other.text)
    former, configured = ask("GET", f"{palm}/history").json()["files"]
    assert former == {
        "number": 1, "id": file.id, "created": CREATED, "sections": ["no_load", "gain", "cover", "health"],
        "error": None,
    }  # fmt: skip
    assert configured == {"number": 0, "id": "configured", "created": None, "sections": [], "error": None}
    assert ask("POST", f"{palm}/history/1").json()["id"] == file.id
    (tmp_path / "palm.json.2").write_text("{")
    refused = problem(ask("POST", f"{palm}/history/2"), 422)
    assert refused.startswith("former calibration 2: truncated, or not JSON")
    assert ask("GET", f"{palm}/history").json()["files"][1]["error"].startswith("truncated")
    assert problem(ask("POST", f"{palm}/history/3"), 404) == "sensor 'palm': no former calibration 3"


def test_the_first_file_is_undone_and_stays_so_after_a_restart(tmp_path, monkeypatch):
    config = parse(CONFIG.format(channel="none").replace(SCALARS, 'file = "palm.json", '), folder=tmp_path)
    file, service, path = calibration_file(), Service(config), tmp_path / "palm.json"
    with running(service) as url:
        palm = url + "/api/v1/sensors/palm/calibration"
        assert problem(ask("POST", f"{palm}/history/0"), 404) == "sensor 'palm': no former calibration 0"
        before = ask("GET", palm).json()
        ask("PUT", f"{palm}/file", content=file.text)
        with monkeypatch.context() as broken:
            broken.setattr("os.fsync", Mock(side_effect=OSError(28, "No space left on device")))
            assert "nothing was written" in problem(ask("POST", f"{palm}/history/0"), 503)
        assert (ask("GET", palm).json()["id"], path.read_text()) == (file.id, file.text)
        undone = ask("POST", f"{palm}/history/0").json()
        assert undone == ask("GET", palm).json()
        assert undone | {"noise": None} == before | {"noise": None}  # it is measured anew
        assert service.events.after(0)[-1].text == "configured: without a file; palm.json is removed"
        assert not path.exists()
        assert Service(config).sensor("palm").plan.calibration_id == "configured"
        (former,) = ask("GET", f"{palm}/history").json()["files"]
        assert (former["number"], former["id"]) == (1, file.id)
        assert ask("POST", f"{palm}/history/1").json()["id"] == file.id
        assert load(path) == file


def test_a_file_longer_than_any_of_its_array_is_refused_unread(palm, monkeypatch):
    monkeypatch.setattr(calibration_file_over_rest, "read", lambda _: pytest.fail("read"))
    line = "a body of more than 288 KiB: no calibration file of this array is as long"
    assert problem(ask("PUT", f"{palm}/file", content=b" " * (289 << 10)), 413) == line


def test_a_file_is_read_beside_the_event_loop(palm, monkeypatch):
    """Reading it takes as long as another answer."""
    answered = []

    def slow(_):
        answered.append(ask("GET", palm).status_code)
        raise ConfigError("it is wrong")

    monkeypatch.setattr(calibration_file_over_rest, "read", slow)
    assert problem(ask("PUT", f"{palm}/file", content=b"{}"), 422) == "body: it is wrong"
    assert answered == [200]


def test_what_cannot_be_applied_is_refused_in_a_line_without_a_path(palm, tmp_path):
    file = calibration_file()
    line = "sensor.palm: palm.json: sensor is 'thumb', and the configuration has 'palm'"
    assert problem(ask("PUT", f"{palm}/file", content=calibration_file(sensor="thumb").text), 422) == line
    altered = file.text.replace("1.5", "2.5")
    assert problem(ask("PUT", f"{palm}/file", content=altered), 422).startswith("body: checksum: does not match")
    assert problem(ask("PUT", f"{palm}/file", content=b"\xff"), 422).startswith("body: not JSON")
    assert "more than 8192 KiB" in problem(ask("PUT", f"{palm}/file", content=b" " * (8 << 20) + b"{}"), 413)
    (tmp_path / "palm.json").mkdir()
    refused = problem(ask("PUT", f"{palm}/file", content=file.text), 503)
    assert "nothing was written" in refused
    assert str(tmp_path) not in refused
    assert ask("GET", palm).json()["id"] == "configured"


def test_a_tare_is_undone(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    assert problem(client.delete("/sensors/palm/tare"), 409) == "sensor 'palm': no tare to undo"
    client.post("/sensors/palm/tare?force=true")
    rig.show_until_tared(pressed())
    tared = client.get("/sensors/palm/calibration").json()
    assert tared["can_undo"]
    assert (
        tared["tared_at"] == client.get("/sensors/palm").json()["tared_at"] == pytest.approx(time.time(), abs=600)
    )
    undone = client.delete("/sensors/palm/tare").json()
    assert (undone["can_undo"], undone["tared_at"], undone["no_load"]) == (False, None, [100.0] * 64)
    assert rig.show(pressed()).raw.max() == 200
