import json
import subprocess
from collections import defaultdict

import numpy as np
import pytest
import rerun_cli
from rerun.chunk import RrdReader

from tactiled.bus import recording
from tactiled.config.example import GRASP
from tests.cli.recordings import HEEL, traffic, write
from tests.cli.test_export import exported, npz_arrays, topics
from tests.cli.test_export_rosbag2 import pictures, values
from tests.conftest import BUSY_S

VIEWER = f"{rerun_cli.__path__[0]}/rerun"


def columns(file):
    """Each entity's columns in the order of time, and of what holds for all time the last."""
    rows, static = defaultdict(lambda: defaultdict(list)), {}
    for chunk in RrdReader(file).stream():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, map(values, batch.columns), strict=True):
            key = name.split(":")[-1]
            if chunk.is_static:
                static[chunk.entity_path, key] = column[-1]
            else:
                rows[chunk.entity_path][key] += column
    return rows, static


def test_an_export_for_rerun_holds_maps_series_and_warnings(tmp_path, config, lossy):
    npz = npz_arrays(lossy, config, tmp_path / "a.npz")
    got, static = columns(exported(lossy, config, tmp_path / "a.rrd"))
    times = [round(each * 1e9) for each in npz["time"].tolist()]
    for name in ("raw", "restored"):
        np.testing.assert_array_equal(pictures(got[f"/palm/{name}"]), npz[name])
        assert got[f"/palm/{name}"]["time"] == pytest.approx(times, abs=1000)
        assert got[f"/palm/{name}"]["frame"] == npz["sequence"].tolist()
        assert static[f"/palm/{name}", "translation"] == [[-0.5, -0.5, 0.0]]  # mm: the first taxel is at (0, 0)
        assert static[f"/palm/{name}", "scale"] == [[1.0, 1.0, 1.0]]
        highest = max(np.nanmax(npz[each]) for each in ("raw", "restored"))
        assert static[f"/palm/{name}", "depth_range"] == [pytest.approx([0.0, highest])]
    assert "log_time" not in got["/palm/raw"]
    force = [each[0] for each in got["/palm/force"]["scalars"]]
    np.testing.assert_allclose(force, 1e-3 * npz["restored"].sum((1, 2)), atol=1e-5)
    peaks = [each[0] for each in got["/palm/peak"]["scalars"]]  # NaN where cells are unknown
    np.testing.assert_allclose(peaks, npz["restored"].max((1, 2)), rtol=1e-6)
    assert static["/palm/force", "names"] == ["force in N"]
    assert got["/palm/contacts"]["labels"][-1] == ["1.40 N"]
    masks = got["/palm/raw/no_data"]
    unknown = {frame: sum(mask[0]) for frame, mask in zip(masks["frame"], masks["buffer"], strict=True)}
    assert (unknown[0], unknown[7], unknown[8]) == (0, 41, 0)
    texts = [each[0] for each in got["/palm/warnings"]["text"]]
    assert texts[0].startswith("41 taxels did not arrive")
    assert texts[1] == "over: missing"
    assert json.loads(static["/__properties/provenance", "json"][0]) == json.loads(npz["provenance"].item())


def test_warnings_that_begin_together_are_in_their_order(tmp_path, config):
    text = config.read_text().replace("kpa_per_count = 0.5, ", "")
    config.write_text(text.replace("saturation = 4000", "saturation = 101, dead = [60]"))
    log = write(tmp_path / "a.log", traffic(missing={(0, 0)}))
    got, _ = columns(exported(log, config, tmp_path / "a.rrd"))
    status = topics(exported(log, config, tmp_path / "a.mcap"))[0]["/palm/status"][0].decoded_message
    texts = [each["text"] for each in status["warnings"]]
    assert len(texts) > 3
    assert [each[0] for each in got["/palm/warnings"]["text"]][: len(texts)] == texts


def test_an_export_for_rerun_has_series_of_the_regions(tmp_path, config, lossy, keep_regions):
    keep_regions(**{"left heel": HEEL})
    expected = npz_arrays(lossy, config, tmp_path / "a.npz")["regions"]
    got, _ = columns(exported(lossy, config, tmp_path / "a.rrd"))
    for k, key in enumerate(("force", "mean", "peak", "area")):
        values = [each[0] for each in got[rf"/palm/regions/left\ heel/{key}"]["scalars"]]
        np.testing.assert_allclose(values, expected[:, 0, k], rtol=1e-5, atol=1e-6)


def test_a_layout_is_a_picture_in_counts_with_the_screen_to_show_it_on(tmp_path):
    log, hand = recording.path("book_1"), tmp_path / "hand.toml"
    hand.write_text(GRASP)
    npz = npz_arrays(log, hand, tmp_path / "a.npz")
    out = exported(log, hand, tmp_path / "a.rrd")
    got, static = columns(out)
    for name, at in (("raw", npz["positions_mm"]), ("restored", npz["cells_mm"])):
        ((x, y, _),), ((side, _, _),) = (static[f"/hand/{name}", key] for key in ("translation", "scale"))
        column, row = np.floor((at - (x, y)) / side).astype(int).T
        np.testing.assert_array_equal(pictures(got[f"/hand/{name}"])[:, row, column], npz[name].reshape(15, -1))
    assert static["/hand/scale", "labels"] == [
        f"100 mm; colours 0 to {max(npz['raw'].max(), np.nanmax(npz['restored'])):.3g} counts"
    ]
    reader = RrdReader(out)
    (screen,) = reader.blueprints()
    views = [chunk.to_record_batch() for chunk in reader.stream(store=screen) if chunk.entity_path.count("/") == 2]
    names = {batch.column("ViewBlueprint:display_name")[0].as_py()[0] for batch in views
             if "ViewBlueprint:display_name" in batch.schema.names}  # fmt: skip
    assert names == {"raw, counts", "restored, counts", "force, counts mm2", "peak, counts", "warnings"}
    check = subprocess.run([VIEWER, "rrd", "verify", out], capture_output=True, text=True, timeout=BUSY_S)
    assert check.returncode == 0, check.stderr
