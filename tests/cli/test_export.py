import csv
import json
import resource
import shutil
import signal
import subprocess
import sys
import tracemalloc
from base64 import b64decode
from collections import defaultdict
from contextlib import contextmanager
from itertools import chain
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import SummaryOffset
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory
from pyarrow import parquet

from tactiled.archive.arrays import METHOD_NAME, Hdf5Writer, NpzWriter, attributes
from tactiled.archive.zarr_group import ZarrWriter
from tactiled.build import make_codec, sensor_plan
from tactiled.bus import recording
from tactiled.cli.app import STOP_SIGNALS, handled, main
from tactiled.config import load, parse
from tactiled.config.example import GRASP
from tactiled.contacts.regions import Region
from tactiled.frames import MISSING
from tactiled.live.pipeline import Pipeline
from tactiled.recorded.frames import RecordedFrames
from tactiled.recorded.playback import Playback, noise_frames
from tactiled.restore.methods import METHODS
from tests.cli.commands import TACTILED, refusal, succeed
from tests.cli.recordings import CONFIG, FRAMES, HEEL, traffic, write
from tests.cli.test_export_zarr import open_zarr
from tests.cli.test_replay import images
from tests.conftest import BUSY_S, until
from tests.diagnostics.test_checks import NOISE, SIDE, sense
from tests.interop.test_foxglove_live import pressures
from tests.skin import CONFIG as SKIN
from tests.skin import SCALE, X, Y, Z, messages


def exported(log, config, out, *arguments):
    succeed("export", log, "--config", config, "-o", out, *arguments)
    return out


def npz_arrays(*arguments):
    """Those of an export to .npz."""
    with np.load(exported(*arguments)) as file:
        return {**file}


def test_an_export_holds_the_images_of_a_replay_and_their_provenance(tmp_path, config, lossy):
    out = tmp_path / "a.npz"
    bus = 'channel = "gone0"\n'
    text = config.read_text().replace(bus, bus + 'password = "hush"\n')
    config.write_text(text.replace("0123456789abcdef", 4 * "hush"))
    output = succeed("export", lossy, "--config", config, "-o", out)
    assert f"a.npz: {FRAMES} frames of palm from 177 messages in " in output
    replayed, _ = images(lossy)
    with np.load(out) as file:
        got = {**file}
    assert (got["raw"].dtype, got["time"].dtype, got["sequence"].dtype) == (np.float32, np.float64, np.int64)
    for name in ("raw", "restored", "flags"):
        assert got[name].shape == (FRAMES, 8, 8)
        assert got[name].tobytes() == np.stack([getattr(each, name) for each in replayed]).tobytes()
    for name in ("time", "sequence", "method", "noise"):
        assert got[name].tolist() == [getattr(each, name) for each in replayed]
    assert got["noise_kpa"].tolist() == got["noise"].tolist()
    assert np.count_nonzero(got["flags"][7] & MISSING) == 41
    np.testing.assert_array_equal(got["positions_mm"][9], (1, 1))
    np.testing.assert_allclose(got["cells_mm"], got["positions_mm"], atol=1e-9)
    assert "shear" not in got
    assert "hush" not in got["provenance"].item()
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
    bus = {"interface": "socketcan", "channel": "gone0", "fd": True, "password": "hidden"}
    assert about["config"]["bus"] == {"can0": bus}


def test_an_export_has_the_regions_that_the_sensor_has_in_its_service(tmp_path, config, lossy, keep_regions):
    keep_regions(all=Region(shape="ellipse", points_mm=[[-9, -9], [16, 16]]), heel=HEEL)
    with np.load(exported(lossy, config, tmp_path / "a.npz")) as got:
        heels = got["restored"][:, :, :4].astype(float)
        assert got["regions"].shape == (FRAMES, 2, 4)
        np.testing.assert_allclose(got["regions"][:, 1, 0], heels.sum((1, 2)) * 1e-3, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(got["regions"][:, 1, 2], heels.max((1, 2)), rtol=1e-6)
        about = json.loads(got["provenance"].item())
    assert [*about["regions"]] == ["all", "heel"]
    assert about["regions"]["heel"]["points_mm"] == [[-0.5, -0.5], [3.5, 7.5]]
    assert about["region_measures"] == ["force", "mean", "peak", "area"]
    assert about["units"]["regions"] == "N, kPa, kPa, mm2"
    with open_zarr(exported(lossy, config, tmp_path / "a.zarr")) as group:
        assert group["regions"].metadata.dimension_names == ("time", "region", "measure")
    got, _ = topics(exported(lossy, config, tmp_path / "a.mcap"))
    content = [each.decoded_message for each in got["/palm/regions"]]
    np.testing.assert_allclose(
        [each["regions"]["heel"].get("peak", np.nan) for each in content], heels.max((1, 2)), rtol=1e-6
    )
    assert (content[0]["unit"], content[0]["force_unit"]) == ("kPa", "N")
    keep_regions(far=Region(shape="rectangle", points_mm=[[90, 90], [91, 91]]))
    text = refusal("export", lossy, "--config", config, "-o", tmp_path / "b.npz")
    assert "regions of sensor palm: points_mm: no cell of the image has its centre in it" in text


def test_hdf5_holds_the_arrays_of_npz_with_their_units(tmp_path, config, lossy):
    npz = npz_arrays(lossy, config, tmp_path / "a.npz")
    with h5py.File(exported(lossy, config, tmp_path / "a.h5")) as got:
        dimensions = {name for name in got if got[name].attrs.get("NAME", b"").startswith(b"This is a netCDF")}
        assert dimensions == {"row", "column", "cell_row", "cell_column", "taxel", "cell", "axis"}
        assert {*got} - dimensions | {"provenance"} == {*npz}
        for name in {*got} - dimensions:
            text = name in ("method", "loss_kind")
            values = got[name].asstr()[()].astype(npz[name].dtype) if text else got[name][()]
            assert values.dtype == npz[name].dtype
            assert values.tobytes() == npz[name].tobytes()
        assert got.attrs["provenance"] == npz["provenance"].item()
        assert got["raw"].attrs["units"] == "kPa"
        assert got["time"].attrs["units"] == "seconds since 1970-01-01"
        assert [each.keys() for each in got["loss"].dims] == [["time"], ["loss_kind"]]


def test_tables_have_a_row_a_frame_and_leave_out_what_is_not_known(tmp_path, config, lossy, keep_regions):
    keep_regions(heel=HEEL)
    npz = npz_arrays(lossy, config, tmp_path / "a.npz")
    table = parquet.read_table(exported(lossy, config, tmp_path / "a.parquet"))
    with exported(lossy, config, tmp_path / "a.csv").open(newline="") as file:
        lines = [*csv.DictReader(file)]
    metadata = parquet.read_metadata(tmp_path / "a.parquet").metadata
    about = {name: json.loads(metadata[name.encode()]) for name in ("provenance", "shapes", "positions_mm")}
    assert about["provenance"] == json.loads(npz["provenance"].item())
    assert about["shapes"] == {"raw": [8, 8], "restored": [8, 8], "flags": [8, 8]}
    np.testing.assert_array_equal(about["positions_mm"], npz["positions_mm"])
    times = table["time"].to_numpy()
    np.testing.assert_array_equal(times, (npz["time"] * 1e6).round().astype("M8[us]"))
    loss = {f"loss_{kind}": npz["loss"][:, n] for n, kind in enumerate(npz["loss_kind"])}
    heel = {f"heel_{each}": npz["regions"][:, 0, n] for n, each in enumerate(npz["measure"])}
    assert "units" not in attributes("regions", about["provenance"])  # of CF, which has one unit a variable
    units = {"heel_force": "_N", "heel_area": "_mm2"} | dict.fromkeys(("heel_mean", "heel_peak", "noise"), "_kPa")
    for name, expected in ({each: npz[each] for each in ("sequence", "method", "noise")} | loss | heel).items():
        assert table[name + units.get(name, "")].to_pylist() == [
            None if each != each else each for each in expected.tolist()
        ]
        text = [each[name + units.get(name, "")] for each in lines]
        if name in units:
            np.testing.assert_allclose([float(each or "nan") for each in text], expected, rtol=1e-5)
        else:
            assert text == [str(each) for each in expected.tolist()]
    assert table["raw"].combine_chunks().values.null_count == np.isnan(npz["raw"]).sum() > 0
    for name, heading in (("raw", "raw_kPa"), ("restored", "restored_kPa"), ("flags", "flags")):
        values = [[np.nan if each is None else each for each in row] for row in table[name].to_pylist()]
        np.testing.assert_array_equal(values, npz[name].reshape(FRAMES, -1))
        cells = [[float(each[f"{heading}_{n // 8}_{n % 8}"] or "nan") for n in range(64)] for each in lines]
        np.testing.assert_array_equal(np.float32(cells), npz[name].reshape(FRAMES, -1))


def test_an_export_names_a_thinner_cover_from_the_frame_on_that_shows_it(tmp_path):
    text = CONFIG.replace("0.8", "1.5").replace("pitch_mm = 1.0", "pitch_mm = 1.0, aperture_mm = 0.8")
    counts = 2 * sense(thickness=0.75, pressure=300, radius=6) + 100
    config = tmp_path / "a.toml"
    config.write_text(text.replace("= 8", f"= {SIDE}").replace("4000", f"4000, noise_kpa = {NOISE}"))
    codec = make_codec(load(config).sensor["palm"])
    frames = [codec.encode(counts.round().astype(np.uint16).ravel(), n, 1.6e9 + n / 100) for n in range(36)]
    log = write(tmp_path / "a.log", chain(*frames))
    one, other = (exported(log, config, tmp_path / name) for name in ("a.mcap", "b.mcap"))
    assert one.read_bytes() == other.read_bytes()
    warnings = [each.decoded_message["warnings"] for each in topics(one)[0]["/palm/status"]]
    named = [{each["code"]: each["thickness_mm"] for each in of_one}.get("cover_mismatch") for of_one in warnings]
    assert named == 32 * [None] + 4 * named[-1:]  # the third check is the 33rd frame's
    assert 0.75 < named[-1] < 1


JSON = SimpleNamespace(decoder_for=lambda encoding, _: json.loads if encoding == "json" else None)


def topics(path):
    """The messages of an MCAP file by topic, and its provenance."""
    with path.open("rb") as file:
        reader, by_topic = make_reader(file, decoder_factories=[DecoderFactory(), JSON]), defaultdict(list)
        for each in reader.iter_decoded_messages():
            by_topic[each.channel.topic].append(each)
        return by_topic, next(iter(reader.iter_metadata())).metadata["json"]


def check_mcap(path):
    """What `mcap doctor` reports: log times that fall, channels without messages, offsets to nothing."""
    with path.open("rb") as file:
        reader = make_reader(file)
        times = [each.log_time for _, _, each in reader.iter_messages(log_time_order=False)]
        summary = reader.get_summary()
        file.seek(0)
        offsets = [each for each in StreamReader(file).records if isinstance(each, SummaryOffset)]
    assert times == sorted(times)
    assert min(summary.statistics.channel_message_counts[number] for number in summary.channels) > 0
    assert len(summary.channels) == len(summary.statistics.channel_message_counts)
    assert all(each.group_length for each in offsets)


def test_mcap_holds_images_and_messages_in_foxgloves_schemas(tmp_path, config, lossy):
    npz = npz_arrays(lossy, config, tmp_path / "a.npz")
    check_mcap(exported(lossy, config, tmp_path / "a.mcap"))
    got, provenance = topics(tmp_path / "a.mcap")
    assert json.loads(provenance) == json.loads(npz["provenance"].item())
    for name in ("raw", "restored"):
        assert {each.schema.name for each in got[f"/palm/{name}"]} == {"foxglove.Grid"}
        grids = [pressures(each.decoded_message) for each in got[f"/palm/{name}"]]
        np.testing.assert_array_equal(grids, npz[name])
    assert [each.decoded_message["method"] for each in got["/palm/status"]] == npz["method"].tolist()
    times = [each.message.publish_time for each in got["/palm/raw"]]
    np.testing.assert_allclose(np.array(times) * 1e-9, npz["time"], atol=1e-6)
    assert [(each.decoded_message["id"], b64decode(each.decoded_message["data"])) for each in got["/can0"]] == [
        (each.id, bytes(each.data)) for each in recording.read(lossy)
    ]


def test_a_layout_without_a_grid(tmp_path):
    log, hand = recording.path("book_1"), tmp_path / "hand.toml"
    hand.write_text(GRASP)
    npz = npz_arrays(log, hand, tmp_path / "a.npz")
    assert npz["raw"].shape == (15, 60)
    provenance = json.loads(npz["provenance"].item())
    assert provenance["warnings"][0]["code"] == "uncalibrated"
    assert npz["restored"].shape == (15, 9, 46)
    assert (np.isfinite(npz["restored"]) == np.array(provenance["mask"])).all()
    np.testing.assert_allclose(provenance["origin_mm"], npz["cells_mm"][0])
    np.testing.assert_allclose(npz["cells_mm"][47] - npz["cells_mm"][0], provenance["cell_mm"])
    got, _ = topics(exported(log, hand, tmp_path / "a.mcap"))
    clouds = [each.decoded_message for each in got["/hand/raw"] if each.schema.name == "foxglove.PointCloud"]
    assert len(clouds) == 15
    points = np.frombuffer(clouds[0].data, "<f4, <f4, <f4, <f4, u1")
    assert (len(points), clouds[0].point_stride) == (60, 17)
    places = np.column_stack([points["f0"], points["f1"]])
    np.testing.assert_allclose(places, 1e-3 * npz["positions_mm"], atol=1e-7)


def test_shear_is_restored_from_the_rest_that_a_recording_begins_with(tmp_path):
    path, rows, shear = tmp_path / "skin.toml", [], np.empty((40, 2, 2, 3), np.float32)
    path.write_text(SKIN.format(channel="skin").replace("dead = [5]", f"dead = [5]{SCALE}"))
    codec = make_codec(load(path).sensor["skin"])
    for n in range(40):
        x, z = (X + 2000, Z + np.array([9000, 9000, 0, 0, 0, 0])) if n >= 36 else (X, Z)
        rows += messages(codec, x, Y, z, now=1.6e9 + n / 100)
        shear[n] = np.reshape([x, Y], (2, 2, 3))
    shear[:, :, 1, 2] = np.nan  # dead
    log = write(tmp_path / "skin.log", rows)
    with np.load(exported(log, path, tmp_path / "a.npz")) as got:
        traction, spread = got["traction"], got["traction_deviation"]
        np.testing.assert_array_equal(got["shear"], shear)  # as sensed
        assert got["shear"].dtype == np.float32
        assert json.loads(got["provenance"].item())["units"]["traction"] == "kPa"
    assert traction.shape == spread.shape == (40, 2, 2, 3)
    assert not traction[:36].any()
    assert traction[-1, 0].max() > 5 * spread[-1, 0].min() > 0
    with h5py.File(exported(log, path, tmp_path / "a.h5")) as got:
        np.testing.assert_array_equal(got["shear"], shear)
        assert got["shear"].attrs["units"].startswith("counts")
    with exported(log, path, tmp_path / "a.csv").open(newline="") as file:
        last = [*csv.DictReader(file)][-1]
    assert float(last["traction_x_kPa_0_0"]) == pytest.approx(traction[-1, 0, 0, 0], rel=1e-4)
    got, _ = topics(exported(log, path, tmp_path / "a.mcap"))
    grids = [each.decoded_message for each in got["/skin/shear"]]
    on_grid = [[pressures(grid, f"shear_{axis}_counts") for axis in "xy"] for grid in grids]
    np.testing.assert_array_equal(on_grid, shear)
    assert (grids[0].cell_size.x, grids[0].pose.position.x) == (0.004, -0.002)
    np.testing.assert_array_equal(
        pressures(got["/skin/traction"][-1].decoded_message, "shear_x_kpa"), traction[-1, 0]
    )
    plan, recorded = sensor_plan("skin", load(path).sensor["skin"]), RecordedFrames(log, {"skin": codec})
    until(lambda: not recorded.reading)
    played = Playback(plan, Pipeline(plan).zero, recorded, noise_frames(plan, recorded, 40))
    np.testing.assert_array_equal(played.image(39, plan.method).traction, traction[-1])
    recorded.close()
    begun = write(tmp_path / "begun.log", rows[36 * 6 :])
    with np.load(exported(begun, path, tmp_path / "b.npz")) as got:
        assert np.isnan(got["traction"]).all()


@pytest.mark.parametrize(
    ("ending", "package", "extra"),
    [
        ("mcap", "foxglove", "foxglove"),
        ("mcap", "mcap", "foxglove"),
        ("h5", "h5py", "hdf5"),
        ("parquet", "pyarrow", "parquet"),
    ],
)
def test_a_missing_library_is_named_before_any_work(tmp_path, config, monkeypatch, ending, package, extra):
    monkeypatch.setattr("tactiled.archive.writers.find_spec", lambda name: name != package)
    message = refusal("export", "gone.log", "--config", config, "-o", tmp_path / f"a.{ending}")
    assert message == f"--out: .{ending} needs {package}: pip install 'tactiled[{extra}]', or export to .npz"


def test_one_of_several_sensors(tmp_path, config, lossy):
    other = CONFIG.split("[sensor.palm]")[1].replace('name = "packed"', 'name = "packed", array_id = 3')
    config.write_text(config.read_text() + "[sensor.thumb]" + other)
    out = tmp_path / "a.npz"
    message = refusal("export", lossy, "--config", config, "-o", out, "--sensor", "thumb")
    assert message.endswith("a.log: holds no frame of sensor thumb (177 messages)")
    assert len(npz_arrays(lossy, config, out, "--sensor", "palm")["raw"]) == FRAMES


def test_a_zone_is_that_of_recordings_that_do_not_say_theirs(tmp_path, config):
    out, blf = tmp_path / "a.npz", write(tmp_path / "a.blf", list(traffic())[:40])
    content = bytearray(blf.read_bytes())
    content[8:10] = 2, 12  # CANoe
    blf.write_bytes(content)
    assert "unknown time zone" in succeed("export", blf, "--config", config, "-o", out)
    with np.load(out) as file:
        times = file["time"]
    moved = npz_arrays(blf, config, tmp_path / "b.npz", "--zone", "Asia/Tokyo")
    assert (times - moved["time"]).tolist() == [9 * 3600.0] * len(times)
    refused = refusal("export", blf, "--config", config, "-o", tmp_path / "c.npz", "--zone", "Mars/Base")
    assert refused == "--zone Mars/Base: no such time zone: give one such as Europe/Berlin"


def test_wrong_files_are_refused_and_nothing_is_written(tmp_path, config, lossy):
    old = tmp_path / "old.npz"
    old.write_text("old")
    both = tmp_path / "both.log"  # boards with one id on two channels
    lines = lossy.read_text().splitlines(keepends=True)
    both.write_text("".join(each + each.replace("can0", "can1") for each in lines))
    before = sorted(tmp_path.iterdir())
    for log, out, message in (
        (lossy, tmp_path / "a.tsv", "unsupported format; use .npz, .h5, .csv, .parquet"),
        (lossy, old, "is there already"),
        (lossy, tmp_path / "gone" / "a.npz", "No such file or directory"),
        (lossy, tmp_path / f"{300 * 'a'}.npz", "File name too long"),
        (tmp_path / "gone.log", tmp_path / "a.npz", "gone.log: No such file"),
        (both, tmp_path / "a.npz", "id 0x500 comes from can0 and from can1"),
    ):
        assert message in refusal("export", log, "--config", config, "-o", out)
    assert sorted(tmp_path.iterdir()) == before
    assert old.read_text() == "old"


@contextmanager
def full_disk(size, monkeypatch):
    """A disk that takes files of so many bytes at most; Python would put cut ones into its cache of bytecode."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def export_with(fault, monkeypatch):
    """Have `fault` happen at frame 30 of an export."""
    process = Pipeline.process

    def faulty(self, frame):
        if frame.sequence == 30:
            fault()
        return process(self, frame)

    with monkeypatch.context() as patch:
        patch.setattr(Pipeline, "process", faulty)
        yield


@pytest.mark.parametrize(
    ("ending", "fault", "message"),
    [
        ("npz", lambda _, out: out.write_text("old"), "is there already: name another file, or remove it first"),
        ("mcap", lambda _, out: shutil.rmtree(out.parent), "No such file or directory: nothing is written"),
        ("npz", lambda log, _: log.unlink(), "a.log: No such file or directory"),
    ],
)
def test_an_export_whose_files_change_meanwhile_is_refused(
    tmp_path, config, lossy, monkeypatch, ending, fault, message
):
    out = tmp_path / "out" / f"a.{ending}"
    out.parent.mkdir()
    with export_with(lambda: fault(lossy, out), monkeypatch):
        assert message in refusal("export", lossy, "--config", config, "-o", out)
    files = list(out.parent.iterdir()) if out.parent.exists() else []
    assert [each.read_text() for each in files] == ["old"] * ("already" in message)


@pytest.mark.parametrize(
    ("ending", "size"), [("npz", 50_000), ("mcap", 20_000), ("parquet", 1000), ("csv", 10_000), ("rrd", 10_000)]
)
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, config, lossy, monkeypatch, ending, size):
    before = sorted(tmp_path.iterdir())
    with full_disk(size, monkeypatch):
        line = refusal("export", lossy, "--config", config, "-o", tmp_path / f"a.{ending}")
    assert "nothing is written" in line
    assert "File too large" in line or ending == "rrd"
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("size_kb", [1, 49])  # of 54
def test_a_full_disk_under_hdf5_is_one_line_and_leaves_nothing(tmp_path, config, lossy, size_kb):
    """In a process of its own: HDF5 does not work as before in one in which a file of it could not be closed."""
    before = sorted(tmp_path.iterdir())
    command = "env", "PYTHONDONTWRITEBYTECODE=1", "bash", "-c", f'ulimit -f {size_kb} && exec "$@"', "-", *TACTILED
    command += "export", lossy, "--config", config, "-o", tmp_path / "a.h5"
    done = subprocess.run(command, capture_output=True, text=True, timeout=4 * BUSY_S)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert "File too large: nothing is written" in done.stderr
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("ending", "kind"), [("npz", signal.SIGTERM), ("h5", signal.SIGINT)])
def test_an_interrupted_export_leaves_nothing(tmp_path, config, lossy, monkeypatch, capsys, ending, kind):
    words = "tactiled", "export", lossy, "--config", config, "-o", tmp_path / f"a.{ending}"
    monkeypatch.setattr(sys, "argv", [*map(str, words)])
    before = sorted(tmp_path.iterdir())
    with (
        handled(signal.default_int_handler, *STOP_SIGNALS),
        export_with(lambda: signal.raise_signal(kind), monkeypatch),
        pytest.raises(SystemExit) as end,
    ):
        main()
    assert end.value.code == 130
    assert capsys.readouterr().err == "tactiled: interrupted: unfinished files are removed\n"
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("form", "load"), [(NpzWriter, np.load), (Hdf5Writer, h5py.File), (ZarrWriter, open_zarr)]
)
def test_memory_does_not_grow_with_the_recording(tmp_path, form, load, monkeypatch):
    row = {"raw": np.ones((64, 64), np.float32), "method": np.array("wiener", METHOD_NAME)}
    monkeypatch.setattr("tactiled.archive.arrays.row", lambda *_: row)
    export = form(tmp_path / "out", sensor_plan("palm", parse(CONFIG).sensor["palm"]))
    tracemalloc.start()
    for _ in range(4000):
        export.add_image(None, {})
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
