import json
import subprocess
import sys
import tracemalloc
from base64 import b64decode
from collections import defaultdict

import h5py
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tactiled.build import make_codec, sensor_plan
from tactiled.bus import recording
from tactiled.cli.export_arrays import METHOD_NAME, Hdf5Export, NpzExport
from tactiled.config import load, parse
from tactiled.config.example import GRASP
from tactiled.frames import MISSING
from tactiled.restore.methods import METHODS
from tests.cli.commands import refusal, succeed
from tests.cli.recordings import CONFIG, FRAMES, write
from tests.cli.test_replay import images
from tests.conftest import BUSY_S
from tests.skin import CONFIG as SKIN
from tests.skin import X, Y, Z, messages


def exported(log, config, out, *arguments):
    succeed("export", log, "--config", config, "-o", out, *arguments)
    return out


@pytest.fixture
def hand(tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(GRASP)
    return path


def test_an_export_holds_the_images_of_a_replay_and_their_provenance(tmp_path, config, lossy):
    out = tmp_path / "a.npz"
    output = succeed("export", lossy, "--config", config, "-o", out)
    assert f"a.npz: {FRAMES} frames of palm from 177 messages in " in output
    replayed, _ = images(lossy)
    with np.load(out) as got:
        assert got["raw"].shape == got["restored"].shape == got["flags"].shape == (FRAMES, 8, 8)
        assert (got["raw"].dtype, got["time"].dtype, got["sequence"].dtype) == (np.float32, np.float64, np.int64)
        for name in ("raw", "restored", "flags"):
            assert got[name].tobytes() == np.stack([getattr(each, name) for each in replayed]).tobytes()
        for name in ("time", "sequence", "method", "noise_kpa"):
            assert got[name].tolist() == [getattr(each, name) for each in replayed]
        assert np.count_nonzero(got["flags"][7] & MISSING) == 41
        np.testing.assert_array_equal(got["positions_mm"][9], (1, 1))
        np.testing.assert_allclose(got["cells_mm"], got["positions_mm"], atol=1e-9)
        assert "shear" not in got
        about = json.loads(got["provenance"].item())
        loss = dict(zip(about["loss_kinds"], got["loss"][-1].tolist(), strict=True))
    assert loss == about["loss"] | {"foreign": FRAMES - 1}  # one message comes behind the last frame
    assert about["loss"]["lost"] == about["loss"]["incomplete"] == 3
    assert about["units"]["raw"] == about["units"]["restored"] == "kPa"
    assert "shear" not in about["units"]
    assert (about["recording"]["file"], about["recording"]["messages"]) == ("a.log", 177)
    assert 0 < about["cover"]["gain_error"] < 0.01
    assert about["made_by"].startswith("tactiled ")
    assert about["config"]["file"] == "a.toml"
    assert about["config"]["sensor"]["palm"] == load(config).sensor["palm"].model_dump(mode="json")
    assert about["config"]["bus"] == {"can0": {"interface": "socketcan", "channel": "gone0", "fd": True}}


@pytest.mark.parametrize("ending", ["npz", "h5", "mcap"])
def test_the_same_export_is_the_same_file(tmp_path, config, lossy, ending):
    one, other = (exported(lossy, config, tmp_path / f"{name}.{ending}") for name in "ab")
    assert one.read_bytes() == other.read_bytes()


def test_hdf5_holds_the_arrays_of_npz_with_their_units(tmp_path, config, lossy):
    for name in ("a.npz", "a.h5"):
        exported(lossy, config, tmp_path / name)
    with np.load(tmp_path / "a.npz") as npz, h5py.File(tmp_path / "a.h5") as got:
        assert {*got} | {"provenance"} == {*npz}
        for name in got:
            values = got[name].asstr()[()].astype(METHOD_NAME) if name == "method" else got[name][()]
            assert values.dtype == npz[name].dtype
            assert values.tobytes() == npz[name].tobytes()
        assert got.attrs["provenance"] == npz["provenance"].item()
        assert got["raw"].attrs["units"] == "kPa"
        assert got["cells_mm"].attrs["units"].startswith("mm")


def json_decoder(encoding, _):
    return json.loads if encoding == "json" else None


json_decoder.decoder_for = json_decoder


def topics(path):
    """The messages of an MCAP file by topic, and its provenance."""
    with path.open("rb") as file:
        reader, by_topic = make_reader(file, decoder_factories=[DecoderFactory(), json_decoder]), defaultdict(list)
        for each in reader.iter_decoded_messages():
            by_topic[each.channel.topic].append(each)
        return by_topic, next(iter(reader.iter_metadata())).metadata["json"]


def pressures(grid, field="pressure_kpa"):
    offset = {each.name: each.offset for each in grid.fields}[field]
    cells = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.cell_stride)
    return cells[:, offset : offset + 4].copy().view("<f4").reshape(-1, grid.column_count)


def test_mcap_holds_images_and_messages_to_scale_in_foxgloves_schemas(tmp_path, config, lossy):
    exported(lossy, config, tmp_path / "a.npz")
    got, provenance = topics(exported(lossy, config, tmp_path / "a.mcap"))
    with np.load(tmp_path / "a.npz") as npz:
        assert json.loads(provenance) == json.loads(npz["provenance"].item())
        for name in ("raw", "restored"):
            assert {each.schema.name for each in got[f"/palm/{name}"]} == {"foxglove.Grid"}
            grids = [pressures(each.decoded_message) for each in got[f"/palm/{name}"]]
            np.testing.assert_array_equal(grids, npz[name])
        assert [each.decoded_message["method"] for each in got["/palm/status"]] == npz["method"].tolist()
        times = [each.message.log_time for each in got["/palm/raw"]]
        np.testing.assert_allclose(np.array(times) * 1e-9, npz["time"], atol=1e-6)
    grid = got["/palm/raw"][0].decoded_message
    assert (grid.frame_id, grid.column_count, grid.cell_size.x, grid.cell_size.y) == ("palm", 8, 0.001, 0.001)
    assert (grid.pose.position.x, grid.pose.position.y) == (-0.0005, -0.0005)
    on_bus = [each.decoded_message for each in got["/can0"]]
    assert len(on_bus) == 177
    assert [(each["id"], b64decode(each["data"])) for each in on_bus] == [
        (each.id, bytes(each.data)) for each in recording.read(lossy)
    ]


def test_a_layout_without_a_grid(tmp_path, hand):
    log = recording.path("book_1")
    with np.load(exported(log, hand, tmp_path / "a.npz")) as got:
        assert got["raw"].shape == (15, 60)
        assert got["restored"].shape == (15, len(got["cells_mm"]))
        assert json.loads(got["provenance"].item())["warnings"][0]["code"] == "uncalibrated"
    got, _ = topics(exported(log, hand, tmp_path / "a.mcap"))
    clouds = [each.decoded_message for each in got["/hand/raw"] if each.schema.name == "foxglove.PointCloud"]
    assert len(clouds) == 15
    points = np.frombuffer(clouds[0].data, "<f4, <f4, <f4, <f4, u1")
    assert (len(points), clouds[0].point_stride) == (60, 17)
    places = sensor_plan("hand", load(hand).sensor["hand"]).array.positions
    np.testing.assert_allclose(np.column_stack([points["f0"], points["f1"]]), 1e-3 * places, atol=1e-7)


def test_shear_of_a_3_axis_skin_in_every_format(tmp_path):
    path, shear = tmp_path / "skin.toml", np.empty((10, 2, 2, 3), np.float32)
    path.write_text(SKIN.format(channel="skin"))
    codec, rows = make_codec(load(path).sensor["skin"]), []
    for n in range(10):
        rows += messages(codec, X + n, Y - n, Z + 10 * n, 1.6e9 + n / 100)
        shear[n] = np.reshape([X + n, Y - n], (2, 2, 3))
    shear[:, :, 1, 2] = np.nan  # dead
    log = write(tmp_path / "skin.log", rows)
    for ending, opened in (("npz", np.load), ("h5", h5py.File)):
        with opened(exported(log, path, tmp_path / f"a.{ending}")) as got:
            np.testing.assert_array_equal(got["shear"][()], shear)
            assert got["shear"].dtype == np.float32
            if ending == "h5":
                assert got["shear"].attrs["units"].startswith("counts")
    got, _ = topics(exported(log, path, tmp_path / "a.mcap"))
    grids = [each.decoded_message for each in got["/skin/shear"]]
    assert {each.schema.name for each in got["/skin/shear"]} == {"foxglove.Grid"}
    np.testing.assert_array_equal(
        [[pressures(grid, f"shear_{axis}_counts") for axis in "xy"] for grid in grids], shear
    )
    assert (grids[0].cell_size.x, grids[0].pose.position.x, grids[0].frame_id) == (0.004, -0.002, "skin")


@pytest.mark.parametrize(
    ("ending", "package", "extra"),
    [("mcap", "foxglove", "foxglove"), ("mcap", "mcap", "foxglove"), ("h5", "h5py", "hdf5")],
)
def test_a_missing_library_is_named_before_any_work(tmp_path, config, monkeypatch, ending, package, extra):
    monkeypatch.setattr("tactiled.cli.export.find_spec", lambda name: name != package)
    message = refusal("export", "gone.log", "--config", config, "-o", tmp_path / f"a.{ending}")
    assert message == f"--out: .{ending} needs {package}: pip install 'tactiled[{extra}]', or export to .npz"


def test_one_of_several_sensors(tmp_path, config, lossy):
    other = CONFIG.split("[sensor.palm]")[1].replace('name = "packed"', 'name = "packed", array_id = 3')
    config.write_text(config.read_text() + "[sensor.thumb]" + other)
    command, out = ("export", lossy, "--config", config, "-o", tmp_path / "a.npz"), tmp_path / "a.npz"
    assert refusal(*command) == "--sensor is missing: choose one of palm, thumb"
    assert refusal(*command, "--sensor", "toe") == "--sensor toe: no such sensor: choose one of palm, thumb"
    message = refusal(*command, "--sensor", "thumb")
    assert message.endswith("a.log: holds no frame of sensor thumb (177 messages)")
    with np.load(exported(lossy, config, out, "--sensor", "palm")) as got:
        assert len(got["raw"]) == FRAMES


def test_wrong_files_are_refused_and_nothing_is_written(tmp_path, config, lossy):
    old = tmp_path / "old.npz"
    old.write_text("old")
    before = sorted(tmp_path.iterdir())
    for log, out, message in (
        (lossy, tmp_path / "a.csv", "unsupported format; use .npz, .h5, .mcap"),
        (lossy, old, "is there already"),
        (lossy, tmp_path / "gone" / "a.npz", "No such file or directory"),
        (lossy, tmp_path / f"{300 * 'a'}.npz", "File name too long"),
        (tmp_path / "gone.log", tmp_path / "a.npz", "gone.log: No such file"),
    ):
        assert message in refusal("export", log, "--config", config, "-o", out)
    assert sorted(tmp_path.iterdir()) == before
    assert old.read_text() == "old"


WITH_FAULT = """
import os, resource, shutil, signal, sys
from pathlib import Path
from tactiled.cli import app, export

log, config, out, fault = sys.argv[1:]
process = export.Pipeline.process
def faulty(self, frame):
    if frame.sequence == 30:
        exec(fault)
    return process(self, frame)
export.Pipeline.process = faulty
sys.argv = ["tactiled", "export", log, "--config", config, "-o", out]
app.main()
"""


def with_fault(log, config, out, fault):
    """The command in a process of its own, to which something happens at its 30th image."""
    command = [sys.executable, "-c", WITH_FAULT, *map(str, (log, config, out)), fault]
    return subprocess.run(command, capture_output=True, text=True, timeout=BUSY_S)


REMOVED, FULL = "shutil.rmtree(Path(out).parent)", "resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))"


@pytest.mark.parametrize(
    ("ending", "fault", "message"),
    [
        ("npz", "Path(out).write_text('old')", "is there already: name another file, or remove it first"),
        ("npz", "Path(out).symlink_to('nowhere')", "is there already: name another file, or remove it first"),
        ("npz", REMOVED, "No such file or directory: nothing is written"),
        ("mcap", REMOVED, "No such file or directory: nothing is written"),
        ("npz", "Path(log).unlink()", "a.log: No such file or directory"),
        ("npz", "os.kill(os.getpid(), signal.SIGTERM)", "interrupted"),
        ("mcap", "os.kill(os.getpid(), signal.SIGTERM)", "interrupted"),
        ("h5", "os.kill(os.getpid(), signal.SIGINT)", "interrupted"),
        # a full disk, in bytes of 58 860, 52 840 and 33 551
        ("npz", FULL.format(1000), "File too large: nothing is written"),
        ("npz", FULL.format(50_000), "File too large: nothing is written"),
        ("h5", FULL.format(1000), "File too large: nothing is written"),
        ("h5", FULL.format(45_000), "File too large: nothing is written"),
        ("h5", FULL.format(50_000), "File too large: nothing is written"),
        ("mcap", FULL.format(30_000), "File too large: nothing is written"),
    ],
)
def test_an_export_that_cannot_end_is_one_line_and_leaves_nothing(tmp_path, config, lossy, ending, fault, message):
    out = tmp_path / "out" / f"a.{ending}"
    out.parent.mkdir()
    done = with_fault(lossy, config, out, fault)
    assert done.returncode == (130 if "kill" in fault else 2), done
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert message in done.stderr
    if "old" in fault:
        assert out.read_text() == "old"
    files = list(out.parent.iterdir()) if out.parent.exists() else []
    assert files == ([out] if "Path(out).w" in fault or "symlink" in fault else [])


def test_a_killed_export_leaves_no_file_under_its_name(tmp_path, config, lossy):
    out = tmp_path / "a.mcap"
    assert with_fault(lossy, config, out, "os.kill(os.getpid(), signal.SIGKILL)").returncode == -9
    assert not out.exists()


SECRETS = """
password = "hush-1"
api_key = "hush-2"
login = { user = "hush-3", number = 5 }
host = "ws://palm:hush-4@elsewhere:1/x?token=hush-5"
tty_baudrate = 115200
"""


def test_provenance_holds_no_secret_however_it_is_spelt(tmp_path, config, lossy):
    text = config.read_text().replace("control_token", '"control\\u005ftoken"')
    config.write_text(text.replace('channel = "gone0"', 'channel = "gone0"' + SECRETS))
    with np.load(exported(lossy, config, tmp_path / "a.npz")) as got:
        provenance = got["provenance"].item()
    assert "hush" not in provenance
    assert "0123456789abcdef" not in provenance
    bus = json.loads(provenance)["config"]["bus"]["can0"]
    assert (bus["password"], bus["api_key"]) == ("hidden", "hidden")
    assert (bus["login"], bus["host"]) == ({"user": "hidden", "number": 5}, "ws://elsewhere:1/x")
    assert (bus["channel"], bus["tty_baudrate"], bus["fd"]) == ("gone0", 115200, True)


@pytest.mark.parametrize(("form", "load"), [(NpzExport, np.load), (Hdf5Export, h5py.File)])
def test_memory_does_not_grow_with_the_recording(tmp_path, form, load, monkeypatch):
    row = {"raw": np.ones((64, 64), np.float32), "method": np.array("wiener", METHOD_NAME)}
    monkeypatch.setattr("tactiled.cli.export_arrays.row", lambda _: row)
    export = form(tmp_path / "out", tmp_path, sensor_plan("palm", parse(CONFIG).sensor["palm"]))
    tracemalloc.start()
    for _ in range(4000):
        export.add_image(None)
    export.finish({"units": {"raw": "kPa"}})
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6  # of 66e6, in pieces of 16 MB
    with load(tmp_path / "out") as got:
        assert got["raw"].shape == (4000, 64, 64)
        assert got["raw"][()].sum() == 4000 * 64 * 64
        assert {*np.array(got["method"]).astype("S16").tolist()} == {b"wiener"}


def test_the_names_of_all_methods_fit():
    assert all(np.array(name, METHOD_NAME) == name for name in METHODS)
