from unittest.mock import Mock

import numpy as np
import pytest

from tactiled.errors import StateError
from tests.calibrate.counts.skins import contact
from tests.calibrating import TIP_MM, TRUE_FACTOR, CalibratedSkin
from tests.conftest import GAIN, problem, until

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
    assert answer.json()["quality"]["advice"] == "4 of 3 loads: enough (0, 100, 200, 400 kPa)"
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
    until(lambda: client.get(SESSION).json()["quality"]["advice"] == "6 of 5 edges: enough")
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
            "pressure_kpa = 20.0: Extra inputs are not permitted",
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
    skin.level(0, 110)  # more than 2 s
    assert client.post(mark, json={"pressure_kpa": 0}).status_code == 200
    skin.offer(np.linspace(0, 50, 40)[:, None] * np.ones(64))
    assert "still move" in problem(client.post(mark, json={"pressure_kpa": 50}), 409)
    for _ in range(2):
        skin.level(50, 110)
        assert client.post(mark, json={"pressure_kpa": 50}).json()["quality"]["presses"] == 2


def test_only_a_live_sensor_is_calibrated(client):
    assert "a calibration needs frames" in problem(client.post(SESSION, json={"way": "tip"}), 409)
