"""Calibrations over REST: guided ones; files, their history, and the tare's undo."""

from unittest.mock import Mock

import numpy as np
import pytest

from tactiled.calibrate.calibration_file import load
from tactiled.config import parse
from tactiled.errors import ConfigError, StateError
from tactiled.live.service import Service
from tactiled.web.rest import calibration_file as calibration_file_over_rest
from tactiled.web.server import running
from tests.calibrate.counts.skins import contact
from tests.calibrate.files import CREATED, calibration_file
from tests.calibrating import TIP_MM, TRUE_FACTOR, CalibratedSkin
from tests.conftest import CONFIG, GAIN, ask, problem, until

SESSION = "/sensors/palm/calibration/session"
CONFIGURED_MM = 0.8


@pytest.fixture
def skin(rig):
    rig.stale_after(600)
    skin = CalibratedSkin(rig)
    skin.level(0)
    return skin


def fitted(client):
    """The session when its fit has ended."""
    answer = client.post(SESSION + "/fit")
    assert (answer.status_code, answer.json()["state"]) == (202, "fitting")
    until(lambda: client.get(SESSION).json()["state"] != "fitting")
    return client.get(SESSION).json()


def image_kpa(rig):
    """The newest raw image (N,) in kPa."""
    return rig.sensor.hub.latest().raw.ravel()


def test_steps_of_pressure_are_fitted_and_applied(rig, client, skin, monkeypatch):
    started = client.post(SESSION, json={"way": "uniform"})
    assert started.status_code == 201, started.text
    assert client.get("/sensors/palm/calibration").json()["session"] == "uniform"
    for kpa in (0, 100, 200, 400):
        skin.level(kpa)
        answer = client.post(SESSION + "/mark", json={"pressure_kpa": kpa})
        assert answer.status_code == 200, answer.text
    assert answer.json()["quality"]["advice"] == "4 loads: enough (0, 100, 200, 400 kPa)"
    gain = fitted(client)["gain"]
    assert gain["before_kpa_per_count"] == GAIN
    low, high = gain["interval_kpa_per_count"]
    assert low < gain["kpa_per_count"] < high
    assert gain["kpa_per_count"] == pytest.approx(np.median(skin.gain), rel=0.02)
    assert gain["spread_percent"] == pytest.approx(100 * skin.gain.std() / skin.gain.mean(), rel=0.05)
    points = [each for each in gain["line"]["measured_kpa"] if each is not None]
    assert points == [100, 200, 400]
    with monkeypatch.context() as patched:
        error = StateError("calibration: No space left on device")
        patched.setattr(rig.service, "apply_calibration", Mock(side_effect=error))
        assert problem(client.post(SESSION + "/apply"), 503) == "calibration: No space left on device"
    assert client.post(SESSION + "/apply").status_code == 204
    problem(client.get(SESSION), 404)
    skin.level(300)
    until(lambda: rig.sensor.hub.latest().sequence == skin.sequence)
    np.testing.assert_allclose(image_kpa(rig), 300, rtol=0.02)
    assert rig.sensor.hub.latest().calibration == rig.sensor.plan.file.id
    kinds = [each.kind for each in rig.service.events.after(0)]
    assert {"calibration_started", "calibration_applied", "calibration_ended"} <= {*kinds}


def test_a_known_weight_gives_one_gain_which_the_next_images_have(rig, client, skin):
    skin.gain[:] = 0.7  # the configuration says 0.5
    array, weight_n = rig.sensor.array, 1.2
    load = contact(array.positions.mean(axis=0)[None], np.array([weight_n]), array, width_mm=0.8)  # (1, N) kPa
    assert client.post(SESSION, json={"way": "weight"}).status_code == 201
    for newtons, pressure in ((0, 0 * load), (weight_n, load)):
        skin.offer(np.repeat(pressure, 110, axis=0))
        answer = client.post(SESSION + "/mark", json={"weight_n": newtons})
        assert answer.status_code == 200, answer.text
    session = fitted(client)
    assert session["state"] == "fitted", session["error"]
    gain = session["gain"]
    assert gain["interval_kpa_per_count"] is None  # it was laid on once
    assert gain["kpa_per_count"] == pytest.approx(0.7, rel=0.02)
    assert client.post(SESSION + "/apply").status_code == 204
    skin.offer(load)
    until(lambda: rig.sensor.hub.latest().sequence == skin.sequence)
    assert image_kpa(rig).sum() == pytest.approx(load.sum(), rel=0.03)


def test_edges_give_the_thickness_which_is_applied(rig, client, skin):
    skin.gain[:] = GAIN
    client.post(SESSION, json={"way": "edge"})
    skin.lay(6)
    skin.level(0)
    until(lambda: client.get(SESSION).json()["quality"]["advice"] == "6 edges: enough")
    cover = fitted(client)["cover"]
    assert cover["thickness_mm"] == pytest.approx(TRUE_FACTOR * CONFIGURED_MM, rel=0.05)
    before = client.get("/sensors/palm/kernel").json()
    assert client.post(SESSION + "/apply").status_code == 204
    assert client.get("/sensors/palm/kernel").json()["nyquist_gain"] < before["nyquist_gain"]  # thicker
    assert rig.sensor.plan.file.cover.thickness_mm == pytest.approx(cover["thickness_mm"])


def test_a_fit_of_nothing_says_why_and_collecting_goes_on(client, skin):
    client.post(SESSION, json={"way": "tip", "tip_mm": TIP_MM})
    skin.level(0, 100)
    session = fitted(client)
    assert session["state"] == "collecting"
    assert "no press stands out of the noise" in session["error"]
    problem(client.post(SESSION + "/apply"), 409)
    client.delete(SESSION)
    client.post(SESSION, json={"way": "uniform"})
    assert "pressure_kpa: 0 loads" in fitted(client)["error"]
    for kpa, entered in ((0, 0), (40, 40), (20, 60)):
        skin.level(kpa)
        client.post(SESSION + "/mark", json={"pressure_kpa": entered})
    assert fitted(client)["error"].startswith("from 40 to 60 kPa the readings fall: ")  # no word of an option


@pytest.mark.usefixtures("skin")
@pytest.mark.parametrize(
    ("path", "body", "status", "words"),
    [
        ("", {"way": "wieght"}, 422, "way = 'wieght'"),
        ("", {"way": "edge", "tip_mm": 2.0}, 422, "tip_mm"),
        ("", {"way": "tip", "tip_mm": 0.0016}, 422, "tip_mm = 0.0016"),
        ("", {"way": "edge", "edge_mm": -1.0}, 422, "edge_mm = -1"),
        ("", {"way": "tip", "tipmm": 2.0}, 422, "tipmm"),
        (
            "/mark",
            {"pressure_kpa": 20.0, "weight_n": 1.0},
            422,
            "pressure_kpa = 20.0: unknown key",
        ),
        ("/mark", {"pressure_kpa": -1.0}, 422, "pressure_kpa = -1.0: Input should be greater than or equal to 0"),
        ("/mark", {"weight_n": "1"}, 422, "weight_n = '1': Input should be a valid number"),
        ("/mark", {"pressure_kpa": 20.0}, 404, "no calibration is open"),
        ("/fit", None, 404, "no calibration is open"),
        ("/apply", None, 404, "no calibration is open"),
    ],
)
def test_a_wrong_request_names_what_is_wrong(client, path, body, status, words):
    detail = problem(client.post(SESSION + path, **({"json": body} if body else {})), status)
    assert words in detail
    assert ";" not in detail  # one fault each


def test_marks_are_refused_by_name_and_keep_what_is_there(client, skin):
    client.post(SESSION, json={"way": "uniform"})
    mark = SESSION + "/mark"
    assert "is open: apply or discard it first" in problem(client.post(SESSION, json={"way": "tip"}), 409)
    assert "weight_n = 5: the calibration is by way 'uniform': give pressure_kpa" in problem(
        client.post(mark, json={"weight_n": 5}), 409
    )
    assert "0 frames since the last" in problem(client.post(mark, json={"pressure_kpa": 0}), 409)
    skin.level(20)
    assert "take 0 first" in problem(client.post(mark, json={"pressure_kpa": 20}), 409)

    def advice():
        return client.post(mark, json={"pressure_kpa": 0}).json()["quality"]["advice"]

    skin.offer(np.tile(40.0 * (np.arange(64) < 5), (110, 1)))  # more than 2 s
    loaded = advice()
    assert "0 kPa was taken under a load (contact of " in loaded
    assert "unload the array and take 0 again. 1 of 3 loads (0 kPa)" in loaded
    skin.level(0, 110)
    assert advice() == "1 of 3 loads (0 kPa)"
    skin.offer(np.linspace(0, 50, 40)[:, None] * np.ones(64))
    assert "still move" in problem(client.post(mark, json={"pressure_kpa": 50}), 409)
    for _ in range(2):
        skin.level(50, 110)
        assert client.post(mark, json={"pressure_kpa": 50}).json()["quality"]["presses"] == 2


def test_only_a_live_sensor_is_calibrated(client):
    assert "a calibration needs frames" in problem(client.post(SESSION, json={"way": "tip"}), 409)


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
        assert (
            service.events.after(0)[-1].text
            == "configured: the values of the configuration hold; palm.json is removed"
        )
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
