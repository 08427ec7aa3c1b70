"""The unit of pressure follows the calibration: all that people and programs see of a sensor."""

import json
import re

import h5py
import numpy as np
import pytest

from tactiled.live.noise import NOISE_FRAMES
from tactiled.messages import foxglove
from tactiled.web.rest.drawing import draw
from tactiled.web.rest.frames import picture
from tactiled.web.server import running
from tests.cli.commands import refusal, succeed
from tests.cli.recordings import CONFIG as RECORDED
from tests.cli.recordings import traffic, write
from tests.cli.test_export import exported, npz_arrays, topics
from tests.client.test_stream import first
from tests.conftest import CONFIG, NO_LOAD, SIDE, Rig, ask, meanwhile, pressed, until
from tests.web.http.raw import npy
from tests.web.ws.clients import stream, text_of

GAIN = "kpa_per_count = 0.5, "
# kPa, N, and values of JSON keys that end in them; an uncalibrated sensor's are null
CLAIM = re.compile(r'kPa|\bN\b|"[a-z_]*(?:_kpa|_n|kpa_per_count)":(?! *null)|pressure_kpa')
UNITS = pytest.mark.parametrize("unit", ["counts", "kPa"])
PATHS = (
    "/sensors", "/health", "/sensors/palm/frames?last=9s", "/events",
    *(f"/sensors/palm/{name}" for name in ("calibration", "health", "contacts")),
    *(f"/sensors/palm/frames/{kind}" for kind in ("raw", "restored", "deviation")),
)  # fmt: skip


def configured(text, unit):
    """A configuration of a calibrated sensor, or the same without its gain."""
    assert GAIN in text
    return text if unit == "kPa" else text.replace(GAIN, "")


def requested(rig, url):
    """What the service answers on a sensor that has been loaded, by what was asked."""
    seen, api = {}, url + "/api/v1"
    for path in PATHS:
        answer = ask("GET", api + path)
        seen[path] = f"{answer.status_code} {answer.headers} {answer.text}"
    answer = ask("POST", api + "/sensors/palm/tare")
    assert answer.status_code == 409
    seen["tare"] = answer.text
    frames = npy(np.zeros((2, SIDE, SIDE)))
    for query in ("noise=2", "noise_kpa=2"):
        answer = ask("POST", f"{api}/restore?sensor=palm&{query}", content=frames)
        seen[f"restore, {query}"] = f"{answer.status_code} {answer.headers}"
    for query in ("top=9", "top_kpa=9"):
        seen[query] = str(ask("GET", f"{api}/sensors/palm/frames/raw?format=png&{query}").status_code)
    with stream(url, "?format=json&contacts=1") as client:
        seen |= {kind: json.dumps(text_of(client, kind)) for kind in ("status", "frame", "contacts")}
    for kind in ("raw", "deviation"):
        figure = draw(picture(rig.sensor, rig.sensor.hub.latest(), kind, None))
        seen[f"PNG, {kind}"] = " ".join(each.get_ylabel() for each in figure.axes)
    seen["metrics"] = ask("GET", url + "/metrics").text
    return seen


def of_foxglove(rig):
    """Foxglove's topics and messages, as far as they are text."""
    image, contacts = rig.sensor.contacts()
    made = foxglove.Topics(rig.sensor.plan, image.unit)
    scene = foxglove.contacts_message("palm", image.time, image.unit, contacts)
    data = [*made.messages(image), scene, *(each.schema_data for each in made.topics if each.encoding == "json")]
    words = b" ".join(b" ".join(re.findall(rb"[ -~]{2,}", each)) for each in data).decode()
    return {"Foxglove": re.sub(r"\b(?<!\d )N\b", "", words)}  # a lone N is one of an image's bytes


@UNITS
def test_answers_streams_pictures_and_metrics_of_a_sensor(unit):
    random = np.random.default_rng(0)
    with meanwhile(Rig(f"units-{unit}", text=configured(CONFIG, unit))) as rig, running(rig.service) as url:
        rig.stale_after(600)
        for _ in range(NOISE_FRAMES):  # above the noise that is configured
            rig.show(random.normal(NO_LOAD + 50, 9, (SIDE, SIDE)))
        image = rig.show(pressed(force=2000))
        until(lambda: any(each.kind == "warning_raised" for each in rig.service.events.after(0)))
        seen = requested(rig, url) | of_foxglove(rig)
        got = first(url)
        assert (got.unit, got.noise) == (unit, pytest.approx(image.noise))
        assert np.isnan(got.noise_kpa) == (unit == "counts")
        np.testing.assert_array_equal(got.raw, image.raw)
        _, (contact,) = rig.sensor.contacts()
    matches = {name: CLAIM.findall(text) for name, text in seen.items()}
    kinds = {"/sensors", "/sensors/palm/contacts", "/events", "tare", "status", "frame", "contacts", "PNG, raw"}
    kinds |= {"Foxglove", "/sensors/palm/calibration"}
    assert image.raw.max() == 2000 * (0.5 if unit == "kPa" else 1)
    listed = json.loads(seen["contacts"])
    scale = 1e-3 if unit == "kPa" else 1.0
    assert listed["contacts"][0]["force"] == pytest.approx(float(image.restored.sum()) * scale, rel=0.2)
    assert listed["contacts"][0]["peak"] == contact.peak == pytest.approx(float(image.restored.max()))
    if unit == "kPa":
        without = {name for name, each in matches.items() if not each}
        assert without <= {"metrics", "/sensors/palm/health", "top=9", "top_kpa=9"}
        assert '"noise_high"' in seen["status"]
        assert (listed["contacts"][0]["force_n"], listed["force_unit"]) == (contact.force, "N")
    else:
        assert {name: each for name, each in matches.items() if each} == {}
        assert "noise_kpa is not used" in seen["status"]
        assert all("counts" in seen[name] for name in kinds)
        assert seen["top_kpa=9"] == seen["restore, noise_kpa=2"][:3] == "409"
    assert seen["top=9"] == seen["restore, noise=2"][:3] == "200"


@UNITS
def test_exports_and_commands_of_a_sensor(unit, tmp_path):
    config, log = tmp_path / "a.toml", write(tmp_path / "a.log", traffic())
    config.write_text(configured(RECORDED, unit))
    npz = npz_arrays(log, config, tmp_path / "a.npz")
    about = json.loads(npz["provenance"].item())
    del about["config"]  # as the user wrote it
    got, _ = topics(exported(log, config, tmp_path / "a.mcap"))
    np.save(tmp_path / "frames.npy", npz["raw"])
    with h5py.File(exported(log, config, tmp_path / "a.h5")) as file:
        seen = {"HDF5": str([(name, each.attrs.get("units")) for name, each in file.items()])}
    seen |= {
        "provenance": json.dumps(about),
        "MCAP": " ".join(json.dumps(each.decoded_message) for each in got["/palm/status"])
        + " ".join(field.name for field in got["/palm/raw"][0].decoded_message.fields),
        "restore": succeed("restore", tmp_path / "frames.npy", "--config", config, "-o", tmp_path / "b.npy"),
        "refusal": refusal("restore", config, "--config", config, "-o", tmp_path / "b.npy"),
    }
    assert ("noise_kpa" in npz) == (unit == "kPa")
    assert npz["noise"][-1] > 0
    matches = {name: CLAIM.findall(text) for name, text in seen.items()}
    assert {name: bool(each) for name, each in matches.items()} == dict.fromkeys(seen, unit == "kPa"), matches
    assert unit in seen["restore"]
    assert CLAIM.findall(succeed("check", config)) == []
