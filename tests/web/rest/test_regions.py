import re

import pytest

from tests.conftest import ask, pressed, problem, until

HEEL = {"shape": "rectangle", "points_mm": [[1.5, 1.5], [5.5, 5.5]]}


def test_a_region_is_watched_measured_and_removed(rig, client, url):
    rig.show(pressed())
    rig.stale_after(600)
    assert client.get("/sensors/palm/regions").json() == {
        "regions": [], "state": "live", "timestamp": pytest.approx(rig.sensor.hub.latest().time), "kept": False
    }  # fmt: skip
    made = client.put("/sensors/palm/regions/heel", json=HEEL).json()
    assert (made["name"], made["shape"], made["now"]) == ("heel", "rectangle", None)
    images = [rig.show(pressed(force=force)) for force in (400, 3000)]
    (heel,) = client.get("/sensors/palm/regions").json()["regions"]
    inside = [image.restored[2:6, 2:6] for image in images]
    area = rig.sensor.plan.cells.side**2
    assert heel["now"]["peak"] == pytest.approx(inside[1].max())
    assert heel["now"]["force"] == pytest.approx(inside[1].sum() * area * 1e-3, rel=1e-5)
    assert heel["now"]["mean"] == pytest.approx(inside[1].mean(), rel=1e-5)
    assert heel["since"] == pytest.approx(images[0].time)
    series = client.get("/sensors/palm/regions/heel/series").json()
    assert series["peak"][0] == pytest.approx(inside[0].max())
    answer = client.get("/sensors/palm/regions/heel/series?format=csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="palm-heel.csv"'
    lines = answer.text.splitlines()
    assert lines[:3] == ["# sensor: palm", "# region: heel", "# time_s: Unix time"]
    assert lines[3] == "time_s,force_N,mean_kPa,peak_kPa,area_mm2,missing_taxels"
    assert lines[4].endswith(",0")
    assert len(lines) == 4 + len(series["time"])
    refused = client.get("/sensors/palm/regions/heel/series?format=xml")
    assert "should be 'json' or 'csv'" in problem(refused, 422)
    metrics = ask("GET", f"{url}/metrics").text
    assert f'tactiled_region_peak{{region="heel",sensor="palm"}} {heel["now"]["peak"]}' in metrics
    rig.stale_after(0)
    answer = client.get("/sensors/palm/regions").json()
    assert (answer["state"], answer["timestamp"]) == ("stale", pytest.approx(images[1].time))
    assert (answer["regions"][0]["now"], answer["regions"][0]["highest"]) == (None, heel["highest"])
    assert "tactiled_region_peak{" not in ask("GET", f"{url}/metrics").text
    assert client.post("/sensors/palm/regions/heel/reset").status_code == 204
    assert client.delete("/sensors/palm/regions/heel").status_code == 204
    refused = client.get("/sensors/palm/regions/heel/series")
    assert "has no region 'heel'; there are: none" in problem(refused, 404)


def test_a_region_over_its_threshold_is_an_event(rig, client):
    body = HEEL | {"threshold": {"quantity": "force", "above": 0.1}}  # below: a tenth less
    assert client.put("/sensors/palm/regions/heel", json=body).json()["threshold"]["below"] == pytest.approx(0.09)
    rig.stale_after(600)
    rig.show(pressed(force=3000))
    rig.show(pressed(force=0))

    def kinds():
        return [each["kind"] for each in client.get("/events").json()["events"] if "region" in each["kind"]]

    until(lambda: kinds() == ["region_above", "region_below"])
    texts = [each["text"] for each in client.get("/events").json()["events"] if "region" in each["kind"]]
    assert "is above 0.1 N" in texts[0]
    assert texts[1].endswith("is below 0.09 N")


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (HEEL | {"points_mm": [[90, 90], [95, 95]]}, 409, "no cell of the image"),
        (
            HEEL | {"points_mm": [[1, 1]]},
            422,
            r"^points_mm = \[\[1, 1\]\]: List should have at least 2 items",
        ),
        (HEEL | {"points_mm": [[1, 1], [2, "b"]]}, 422, r"^points_mm\[1\]\[1\] = 'b': Input should be a"),
        (HEEL | {"colour": "red"}, 422, "colour"),
        (HEEL | {"threshold": {"quantity": "force", "above": "1"}}, 422, "^threshold.above = '1': [^;]*$"),
    ],
)
def test_a_wrong_region_is_refused_and_changes_nothing(client, rig, body, status, words):
    assert re.search(words, problem(client.put("/sensors/palm/regions/heel", json=body), status))
    assert rig.sensor.regions.regions == {}


def test_a_region_may_not_have_the_name_of_the_array_in_a_series(client):
    """Its columns in the CSV of a recording's series would be there twice."""
    detail = problem(client.put("/sensors/palm/regions/total", json=HEEL), 409)
    assert detail == "region = 'total': a series has this name for the array: give another"
    assert client.put("/sensors/palm/regions/Total", json=HEEL).status_code == 200
