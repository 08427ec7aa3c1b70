import importlib.util
import json
import subprocess
import sys
import tracemalloc
from base64 import b64decode
from collections import defaultdict
from pathlib import Path

import h5py
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

from tactiled.build import make_codec, sensor_plan
from tactiled.bus import recording
from tactiled.cli import app as door
from tactiled.cli.export_arrays import METHOD_NAME as METHOD
from tactiled.cli.export_arrays import Columns, Hdf5Export, NpzExport
from tactiled.config import load
from tactiled.config.example import GRASP
from tactiled.errors import TactileError
from tactiled.frames import MISSING
from tactiled.restore.methods import METHODS
from tests.conftest import BUSY_S
from tests.skin import CONFIG as SKIN
from tests.skin import X, Y, Z, messages

_spec = importlib.util.spec_from_file_location("replay_tests", Path(__file__).with_name("test_replay.py"))
beside = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(beside)
CONFIG, FRAMES, codec, lossy = beside.CONFIG, beside.FRAMES, beside.codec, beside.lossy


def run(*arguments):
    return CliRunner().invoke(door.app, ["export", *map(str, arguments)])


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[server]\ncontrol_token = "0123456789abcdef"  # secret\n' + CONFIG)
    return path


def test_an_export_is_what_a_replay_shows(tmp_path, config, lossy):
    out = tmp_path / "a.npz"
    done = run(lossy, "--config", config, "-o", out)
    assert done.exit_code == 0, done.output
    assert f"a.npz: {FRAMES} frames of palm from 177 messages in " in done.output
    images, _ = beside.images(lossy)
    with np.load(out) as got:
        assert got["raw"].shape == got["restored"].shape == got["flags"].shape == (FRAMES, 8, 8)
        assert (got["raw"].dtype, got["time"].dtype, got["sequence"].dtype) == (np.float32, np.float64, np.int64)
        for name in ("raw", "restored", "flags"):
            assert got[name].tobytes() == np.stack([getattr(each, name) for each in images]).tobytes()
        for name in ("time", "sequence", "method", "noise_kpa"):
            assert got[name].tolist() == [getattr(each, name) for each in images]
        assert np.count_nonzero(got["flags"][7] & MISSING) == 41
        np.testing.assert_array_equal(got["positions_mm"][9], (1, 1))
        np.testing.assert_allclose(got["cells_mm"], got["positions_mm"], atol=1e-9)
        about = json.loads(got["provenance"].item())
        loss = dict(zip(about["loss_kinds"], got["loss"][-1].tolist(), strict=True))
    assert loss == about["loss"] | {"foreign": FRAMES - 1}  # one message comes behind the last frame
    assert about["loss"]["lost"] == about["loss"]["incomplete"] == 3
    assert about["units"]["raw"] == about["units"]["restored"] == "kPa"
    assert about["recording"]["file"] == "a.log"
    assert about["recording"]["messages"] == 177
    assert 0 < about["cover"]["gain_error"] < 0.01
    assert about["made_by"].startswith("tactiled ")
    assert about["config"]["file"] == "a.toml"
    assert about["config"]["sensor"]["palm"] == load(config).sensor["palm"].model_dump(mode="json")
    assert about["config"]["bus"] == {"can0": {"interface": "socketcan", "channel": "gone0", "fd": True}}
    assert "0123456789abcdef" not in json.dumps(about)


@pytest.mark.parametrize("ending", ["npz", "h5", "mcap"])
def test_the_same_export_is_the_same_file(tmp_path, config, lossy, ending):
    one, other = (tmp_path / f"{name}.{ending}" for name in "ab")
    for out in (one, other):
        assert run(lossy, "--config", config, "-o", out).exit_code == 0
    assert one.read_bytes() == other.read_bytes()


def test_hdf5_holds_the_same_with_each_unit_beside_its_array(tmp_path, config, lossy):
    for name in ("a.npz", "a.h5"):
        assert run(lossy, "--config", config, "-o", tmp_path / name).exit_code == 0
    with np.load(tmp_path / "a.npz") as wanted, h5py.File(tmp_path / "a.h5") as got:
        assert {*got} | {"provenance"} == {*wanted}
        for name in got:
            there = got[name].asstr()[()].astype(METHOD) if name == "method" else got[name][()]
            assert there.dtype == wanted[name].dtype
            assert there.tobytes() == wanted[name].tobytes()
        assert got.attrs["provenance"] == wanted["provenance"].item()
        assert got["raw"].attrs["units"] == "kPa"
        assert got["cells_mm"].attrs["units"].startswith("mm")


def test_mcap_holds_images_and_messages_to_scale_in_foxgloves_schemas(tmp_path, config, lossy):
    for name in ("a.npz", "a.mcap"):
        assert run(lossy, "--config", config, "-o", tmp_path / name).exit_code == 0
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory(), json_decoder])
        got = defaultdict(list)
        for each in reader.iter_decoded_messages():
            got[each.channel.topic].append(each)
        kept = json.loads(next(iter(reader.iter_metadata())).metadata["json"])
    with np.load(tmp_path / "a.npz") as wanted:
        assert kept == json.loads(wanted["provenance"].item())
        for topic, name in (("/palm/raw", "raw"), ("/palm/restored", "restored")):
            assert {each.schema.name for each in got[topic]} == {"foxglove.Grid"}
            images = [pressures(each.decoded_message) for each in got[topic]]
            np.testing.assert_array_equal(images, wanted[name])
        assert [each.decoded_message["method"] for each in got["/palm/status"]] == wanted["method"].tolist()
        times = [each.message.log_time for each in got["/palm/raw"]]
        np.testing.assert_allclose(np.array(times) * 1e-9, wanted["time"], atol=1e-6)
    grid = got["/palm/raw"][0].decoded_message
    assert (grid.frame_id, grid.column_count, grid.cell_size.x, grid.cell_size.y) == ("palm", 8, 0.001, 0.001)
    assert (grid.pose.position.x, grid.pose.position.y) == (-0.0005, -0.0005)
    sent = [(each.id, bytes(each.data)) for each in recording.read(lossy)]
    heard = [(each.decoded_message["id"], b64decode(each.decoded_message["data"])) for each in got["/can0"]]
    assert heard == sent[: len(heard)]
    assert len(heard) == 177


def json_decoder(encoding, _):
    return json.loads if encoding == "json" else None


json_decoder.decoder_for = json_decoder


def pressures(grid, field="pressure_kpa"):
    offset = {each.name: each.offset for each in grid.fields}[field]
    cells = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.cell_stride)
    return cells[:, offset : offset + 4].copy().view("<f4").reshape(-1, grid.column_count)


def test_a_layout_is_a_cloud_of_points_in_mcap(tmp_path):
    path, out = tmp_path / "hand.toml", tmp_path / "a.mcap"
    path.write_text(GRASP)
    assert run(recording.path("book_1"), "--config", path, "-o", out).exit_code == 0
    with out.open("rb") as file:
        clouds = [
            each.decoded_message
            for each in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages("/hand/raw")
            if each.schema.name == "foxglove.PointCloud"
        ]
    assert len(clouds) == 15
    points = np.frombuffer(clouds[0].data, "<f4, <f4, <f4, <f4, u1")
    assert (len(points), clouds[0].point_stride) == (60, 17)
    places = sensor_plan("hand", load(path).sensor["hand"]).array.positions
    np.testing.assert_allclose(np.column_stack([points["f0"], points["f1"]]), 1e-3 * places, atol=1e-7)


@pytest.fixture
def sheared(tmp_path):
    """Ten frames of a 3-axis skin, and what they were felt as."""
    path, log = tmp_path / "skin.toml", tmp_path / "skin.log"
    path.write_text(SKIN.format(channel="skin"))
    codec = make_codec(load(path).sensor["skin"])
    beside.write(
        log, (each for n in range(10) for each in messages(codec, X + n, Y - n, Z + 10 * n, 1.6e9 + n / 100))
    )
    felt = np.stack([[X + n, Y - n] for n in range(10)]).astype(np.float32).reshape(10, 2, 2, 3)
    felt[:, :, 1, 2] = np.nan  # dead
    return path, log, felt


@pytest.mark.parametrize("ending", ["npz", "h5"])
def test_arrays_have_shear_with_its_unit_where_the_skin_feels_it(tmp_path, sheared, ending):
    path, log, felt = sheared
    out = tmp_path / f"a.{ending}"
    assert run(log, "--config", path, "-o", out).exit_code == 0
    with np.load(out) if ending == "npz" else h5py.File(out) as got:
        np.testing.assert_array_equal(got["shear"][()], felt)
        assert got["shear"].dtype == np.float32
        about = json.loads(got["provenance"].item() if ending == "npz" else got.attrs["provenance"])
        if ending == "h5":
            assert got["shear"].attrs["units"] == about["units"]["shear"]
    assert about["units"]["shear"].startswith("counts")


def test_an_export_of_a_skin_without_shear_has_none(tmp_path, config, lossy):
    assert run(lossy, "--config", config, "-o", tmp_path / "a.npz").exit_code == 0
    with np.load(tmp_path / "a.npz") as got:
        assert "shear" not in got
        assert "shear" not in json.loads(got["provenance"].item())["units"]


def test_shear_changes_nothing_in_the_images(tmp_path, sheared):
    """The normal axis alone, without the other two, gives the same ones bit for bit."""
    path, log, _ = sheared
    codec = make_codec(load(path).sensor["skin"])
    plain = [
        each for n in range(10) for each in codec.encode(np.asarray(Z + 10 * n, np.uint16), 0, 1.6e9 + n / 100)
    ]
    for recorded, out in ((log, "a.npz"), (beside.write(tmp_path / "b.log", plain), "b.npz")):
        assert run(recorded, "--config", path, "-o", tmp_path / out).exit_code == 0
    with np.load(tmp_path / "a.npz") as one, np.load(tmp_path / "b.npz") as other:
        for name in ("raw", "restored", "flags"):
            assert one[name].tobytes() == other[name].tobytes()
        assert np.nanmax(np.abs(other["shear"])) == 0


def test_mcap_has_a_topic_of_shear_where_the_skin_feels_it(tmp_path, sheared):
    path, log, felt = sheared
    assert run(log, "--config", path, "-o", tmp_path / "a.mcap").exit_code == 0
    with (tmp_path / "a.mcap").open("rb") as file:
        got = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages("/skin/shear"))
    grids = [each.decoded_message for each in got]
    assert {each.schema.name for each in got} == {"foxglove.Grid"}
    told = [[pressures(grid, f"shear_{axis}_counts") for axis in "xy"] for grid in grids]
    np.testing.assert_array_equal(told, felt)
    assert (grids[0].cell_size.x, grids[0].pose.position.x, grids[0].frame_id) == (0.004, -0.002, "skin")


def test_mcap_without_its_library_is_told_before_any_work(tmp_path, config, lossy, monkeypatch):
    monkeypatch.setattr("tactiled.interop.foxglove.messages", None)
    told = run(lossy, "--config", config, "-o", tmp_path / "a.mcap").exception
    assert str(told) == "--out: .mcap needs Foxglove's SDK: pip install 'tactiled[foxglove]'"


def test_hdf5_without_its_library_is_told_before_any_work(tmp_path, config, lossy, monkeypatch):
    monkeypatch.setattr("tactiled.cli.export_arrays.find_spec", {"h5py": None}.__getitem__)
    told = run(lossy, "--config", config, "-o", tmp_path / "a.h5").exception
    assert str(told) == "--out: .h5 needs h5py: pip install 'tactiled[hdf5]', or export to .npz"


def test_a_skin_without_a_grid(tmp_path):
    path, out = tmp_path / "hand.toml", tmp_path / "a.npz"
    path.write_text(GRASP)
    assert run(recording.path("book_1"), "--config", path, "-o", out).exit_code == 0
    with np.load(out) as got:
        assert got["raw"].shape == (15, 60)
        assert got["restored"].shape == (15, len(got["cells_mm"]))
        assert json.loads(got["provenance"].item())["warnings"][0]["code"] == "uncalibrated"


def test_one_of_several_sensors(tmp_path, config, lossy):
    other = CONFIG.split("[sensor.palm]")[1].replace('name = "packed"', 'name = "packed", array_id = 3')
    config.write_text(config.read_text() + "[sensor.thumb]" + other)
    out = tmp_path / "a.npz"
    told = run(lossy, "--config", config, "-o", out).exception
    assert str(told) == "--sensor is missing: choose one of palm, thumb"
    told = run(lossy, "--config", config, "-o", out, "--sensor", "toe").exception
    assert str(told) == "--sensor toe: no such sensor: choose one of palm, thumb"
    told = run(lossy, "--config", config, "-o", out, "--sensor", "thumb").exception
    assert str(told).endswith("a.log: holds no frame of sensor thumb (177 messages)")
    assert run(lossy, "--config", config, "-o", out, "--sensor", "palm").exit_code == 0
    with np.load(out) as got:
        assert len(got["raw"]) == FRAMES


def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(tmp_path, config, lossy):
    there = tmp_path / "there.npz"
    there.write_text("mine")
    before = sorted(tmp_path.iterdir())
    for recorded, out, says in (
        (lossy, tmp_path / "a.csv", "unsupported format; use .npz, .h5, .mcap"),
        (lossy, there, "is there already"),
        (lossy, tmp_path / "gone" / "a.npz", "No such file or directory"),
        (lossy, tmp_path / f"{300 * 'a'}.npz", "File name too long"),
        (tmp_path / "gone.log", tmp_path / "a.npz", "gone.log: No such file"),
    ):
        told = run(recorded, "--config", config, "-o", out).exception
        assert isinstance(told, TactileError)
        assert says in str(told)
        assert "\n" not in str(told)
    assert sorted(tmp_path.iterdir()) == before
    assert there.read_text() == "mine"


WITHIN = """
import os, resource, signal, sys
from pathlib import Path
from tactiled.cli import app as door, export

log, config, out, fault = sys.argv[1:]
once = export._images
def images(*arguments):
    for n, image in enumerate(once(*arguments)):
        if n == 30:
            exec(fault)
        yield image
export._images = images
sys.argv = ["tactiled", "export", log, "--config", config, "-o", out]
door.main()
"""


def exported(log, config, out, fault):
    """The command in a process of its own, to which something happens at its 30th image."""
    return subprocess.run(
        [sys.executable, "-c", WITHIN, *map(str, (log, config, out)), fault],
        capture_output=True, text=True, timeout=BUSY_S,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("ending", "fault", "says"),
    [
        ("npz", "Path(out).write_text('mine')", "is there already: name another file, or remove it first"),
        ("npz", "Path(out).symlink_to('nowhere')", "is there already: name another file, or remove it first"),
        (
            "npz",
            "import shutil; shutil.rmtree(Path(out).parent)",
            "No such file or directory: nothing is written",
        ),
        ("h5", "import shutil; shutil.rmtree(Path(out).parent)", "No such file or directory: nothing is written"),
        (
            "mcap",
            "import shutil; shutil.rmtree(Path(out).parent)",
            "No such file or directory: nothing is written",
        ),
        ("npz", "Path(log).unlink()", "a.log: No such file or directory"),
        ("npz", "os.kill(os.getpid(), signal.SIGTERM)", "interrupted"),
        ("mcap", "os.kill(os.getpid(), signal.SIGTERM)", "interrupted"),
        ("h5", "os.kill(os.getpid(), signal.SIGINT)", "interrupted"),
    ],
)
def test_an_export_that_cannot_end_is_one_line_and_leaves_nothing(tmp_path, config, lossy, ending, fault, says):
    out = tmp_path / "out" / f"a.{ending}"
    out.parent.mkdir()
    done = exported(lossy, config, out, fault)
    assert done.returncode in (2, 130), done
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert says in done.stderr
    left = list(out.parent.iterdir()) if out.parent.exists() else []
    if "mine" in fault:
        assert out.read_text() == "mine"
        left.remove(out)
    if "symlink" in fault:
        assert not out.exists()
        left.remove(out)
    assert not left


@pytest.mark.parametrize(
    ("ending", "size"),  # bytes, of 58 860, 52 840 and 33 551
    [
        ("npz", 1000),
        ("npz", 50_000),
        ("h5", 1000),
        ("h5", 45_000),
        ("h5", 50_000),
        ("mcap", 1000),
        ("mcap", 30_000),
    ],
)
def test_a_disk_that_is_full_at_any_point_is_one_line(tmp_path, config, lossy, ending, size):
    out = tmp_path / "out" / f"a.{ending}"
    out.parent.mkdir()
    done = exported(lossy, config, out, f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))")
    assert done.returncode == 2, done
    assert done.stderr == f"tactiled: {out}: File too large: nothing is written\n"
    assert not list(out.parent.iterdir())


def test_a_killed_export_leaves_no_half_of_a_file_under_its_name(tmp_path, config, lossy):
    out = tmp_path / "a.mcap"
    assert exported(lossy, config, out, "os.kill(os.getpid(), signal.SIGKILL)").returncode == -9
    assert not out.exists()
    assert run(lossy, "--config", config, "-o", out).exit_code == 0


SECRETS = """
password = "hush-1"
api_key = "hush-2"
login = { user = "hush-3", number = 5 }
host = "ws://palm:hush-4@elsewhere:1/x?token=hush-5"
tty_baudrate = 115200
"""


@pytest.mark.parametrize("ending", ["npz", "h5", "mcap"])
def test_provenance_holds_no_secret_however_it_is_spelt(tmp_path, config, lossy, ending):
    text = config.read_text().replace("control_token", '"control\\u005ftoken"')
    config.write_text(text.replace('channel = "gone0"', 'channel = "gone0"' + SECRETS))
    out = tmp_path / f"a.{ending}"
    assert run(lossy, "--config", config, "-o", out).exit_code == 0
    if ending == "mcap":
        with out.open("rb") as file:
            text = next(iter(make_reader(file).iter_metadata())).metadata["json"]
    else:
        with np.load(out) if ending == "npz" else h5py.File(out) as got:
            text = got["provenance"].item() if ending == "npz" else got.attrs["provenance"]
    assert "hush" not in text
    assert "0123456789abcdef" not in text
    bus = json.loads(text)["config"]["bus"]["can0"]
    assert (bus["password"], bus["api_key"]) == ("hidden", "hidden")
    assert (bus["login"], bus["host"]) == ({"user": "hidden", "number": 5}, "ws://elsewhere:1/x")
    assert (bus["channel"], bus["tty_baudrate"], bus["fd"]) == ("gone0", 115200, True)


@pytest.mark.parametrize(("save", "load"), [(NpzExport.save, np.load), (Hdf5Export.save, h5py.File)])
def test_memory_does_not_grow_with_the_recording(tmp_path, save, load):
    columns, out = Columns(tmp_path), tmp_path / "out"
    row = {"raw": np.ones((64, 64), np.float32), "method": np.array("wiener", METHOD)}
    tracemalloc.start()
    for _ in range(4000):
        columns.add(row)
    save(out, columns.arrays() | {"whole": np.arange(3)}, {"units": {"raw": "kPa"}})
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20e6  # of 66e6, in pieces of 16 MB
    with load(out) as got:
        assert got["raw"].shape == (4000, 64, 64)
        assert got["raw"][()].sum() == 4000 * 64 * 64
        assert {str(each, "ascii") if isinstance(each, bytes) else str(each) for each in got["method"]} == {
            "wiener"
        }
        assert got["whole"][()].tolist() == [0, 1, 2]


def test_the_names_of_all_methods_fit():
    assert all(np.array(name, METHOD) == name for name in METHODS)
