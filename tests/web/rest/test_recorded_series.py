"""Force, mean, peak and contact area over a recording, in total and in regions."""

import csv

import httpx
import numpy as np
import pytest

from tactiled.archive.export import ExportJob
from tactiled.config import Server, parse
from tactiled.contacts.regions import Region
from tactiled.live.service import Service
from tactiled.recorded import series as recorded_series
from tactiled.web.server import running
from tests.cli.recordings import CONFIG, FRAMES, traffic, write
from tests.conftest import HTTP, problem, until

PALM = {"sensor": "palm"}
HEEL = Region(shape="rectangle", points_mm=((1.5, -1), (5.5, 3.5)))
TOE = Region(shape="ellipse", points_mm=((3, 3), (8, 8)))


@pytest.fixture(scope="module")
def service():
    service = Service(parse(CONFIG))
    for name, region in (("heel", HEEL), ("toe", TOE)):
        service.sensor("palm").regions.put(name, region)
    return service


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("recordings") / "grasp.log", list(traffic(missing={(20, 1)})))


@pytest.fixture(scope="module")
def client(service, path):
    server = Server(port=0, recordings=path.parent, recordings_leave_mb=0, control_per_minute=0)
    with running(service, server) as url, httpx.Client(**HTTP, base_url=f"{url}/api/v1/recordings") as client:
        yield client


def measured(client, **query):
    """The series of the recording, once every frame is measured."""
    get = lambda: client.get("/grasp.log/series", params=PALM | query)  # noqa: E731
    until(lambda: (answer := get()).status_code == 200 and not answer.json()["running"], 60)
    return get().json()


def exported(path, regions):
    """Measures (T, regions, 4) and images (T, cells) of an export, and the area of a cell, mm2."""
    (path.parent / "palm.toml").write_text(CONFIG)
    job = ExportJob.of(path.parent / "palm.toml", parse(CONFIG), "palm", regions=regions)
    target = path.with_suffix(".npz")
    job.make(path, target)
    with np.load(target) as arrays:
        return arrays["regions"], arrays["restored"].reshape(FRAMES, -1), job.plan().cells.side ** 2


def test_a_series_has_what_an_export_has_for_every_frame_and_its_highest_values(client, path):
    expected, restored, cell_area = exported(path, {"heel": HEEL, "toe": TOE})
    series = measured(client, regions="heel,toe")
    assert [series[key] for key in ("frames", "measured", "error", "unit")] == [FRAMES, FRAMES, None, "kPa"]
    for n, area in enumerate(series["regions"]):
        assert area["name"] == ("heel", "toe")[n]
        for k, key in enumerate(("force", "mean", "peak", "area")):
            np.testing.assert_allclose(np.array(area[key], float), expected[:, n, k], rtol=1e-6)
        for k, key in enumerate(("force", "peak")):
            best = int(np.nanargmax(expected[:, n, 2 * k]))
            highest = area["highest"][key]
            assert highest["number"] == best
            assert highest["value"] == pytest.approx(expected[best, n, 2 * k])
            assert highest["position_s"] == pytest.approx(series["position_s"][best])
    total = 1e-3 * cell_area * restored.sum(axis=1)
    np.testing.assert_allclose(np.array(series["total"]["force"], float), total, rtol=1e-4)
    assert np.flatnonzero(np.isnan(total)).tolist() == [20]  # its message was lost
    details = client.get("/grasp.log/frames/50", params=PALM).json()
    assert [each["name"] for each in details["regions"]] == ["heel", "toe"]
    assert details["regions"][1]["peak"] == pytest.approx(series["regions"][1]["peak"][50])


def test_the_csv_of_a_series_has_every_frame(client):
    series = measured(client, regions="heel", method="raw")
    answer = client.get("/grasp.log/series", params=PALM | {"regions": "heel", "method": "raw", "format": "csv"})
    rows = list(csv.DictReader(answer.text.splitlines()))
    assert answer.headers["content-disposition"] == 'attachment; filename="grasp-palm.csv"'
    assert list(rows[0])[:3] == ["frame", "position_s", "total_force_N"]
    assert list(rows[0])[6:] == [
        "heel_force_N",
        "heel_mean_kPa",
        "heel_peak_kPa",
        "heel_area_mm2",
        "missing_taxels",
    ]
    assert [int(each["frame"]) for each in rows] == list(range(FRAMES))
    assert [n for n, each in enumerate(rows) if int(each["missing_taxels"])] == [20]
    forces = [float(each["heel_force_N"] or "nan") for each in rows]
    np.testing.assert_allclose(forces, np.array(series["regions"][0]["force"], float), rtol=1e-5)


def test_of_a_long_recording_each_piece_has_its_highest_value(client, monkeypatch):
    every = measured(client, regions="toe")["regions"][0]
    monkeypatch.setattr(recorded_series, "MAX_POINTS", 7)
    pieces = measured(client, regions="toe", method="nnls")
    assert len(pieces["position_s"]) == len(pieces["total"]["force"]) == 7
    assert max(pieces["regions"][0]["force"]) == pieces["regions"][0]["highest"]["force"]["value"]
    assert len(every["force"]) == FRAMES


def test_what_cannot_be_measured_is_refused_in_a_line(client):
    get = lambda **query: client.get("/grasp.log/series", params=PALM | query)  # noqa: E731
    measured(client)
    assert problem(get(regions="heal"), 404) == "sensor 'palm' has no region 'heal'; there are: heel, toe"
    assert "best" in problem(get(method="best"), 422)
    assert problem(get(sensor="plam"), 404).startswith("sensor 'plam'")


def test_one_series_is_measured_at_a_time(client, monkeypatch):
    measured(client)
    monkeypatch.setattr(recorded_series.RecordedSeries, "running", property(lambda _: True))
    answer = client.get("/grasp.log/series", params=PALM | {"method": "wiener"})
    assert problem(answer, 409) == "recording grasp.log: another series is being measured"
    csv = client.get("/grasp.log/series", params=PALM | {"format": "csv"})
    assert problem(csv, 409) == f"recording grasp.log: {FRAMES} of {FRAMES} frames are measured"
