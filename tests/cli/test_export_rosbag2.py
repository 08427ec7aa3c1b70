import sqlite3
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import mcap.reader
import numpy as np
import pytest
import yaml
from rerun.chunk import McapReader
from rosbags.highlevel import AnyReader

from tactiled.bus import recording
from tactiled.config import ros_name
from tactiled.config.example import GRASP
from tactiled.frames import FLAG_BITS, MISSING
from tests.cli.commands import refusal
from tests.cli.recordings import HEEL
from tests.cli.test_export import check_mcap, exported, npz_arrays

ORIGIN_MM, ORIENTATION = [10.0, 0.0, 2.5], [0.0, 0.0, 0.7071, 0.7071]
PLACE = f'pitch_mm = 1.0, frame_id = "hand", origin_mm = {ORIGIN_MM}, orientation = {ORIENTATION}'
# What rosbag2 0.22 to 0.34 reads of metadata.yaml: rosbag2_storage/include/rosbag2_storage/yaml.hpp
METADATA = {
    "version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count",
    "relative_file_paths", "compression_format", "compression_mode", "files", "custom_data", "ros_distro",
}  # fmt: skip
TOPIC = {"name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"}
QOS = {
    "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
    "liveliness_lease_duration", "avoid_ros_namespace_conventions",
}  # fmt: skip
PALM = {"raw", "restored", "tactile", "markers", "layout", "wrench"}


def bag(log, config, out, to="rosbag2"):
    """The MCAP file of a bag."""
    return exported(log, config, out, "--to", to) / f"{out.name}.mcap"


def values(column):
    return (column.cast("int64") if str(column.type).startswith("timestamp") else column).to_pylist()


def columns(file):
    """What Rerun, whose reader of ROS 2's messages is another, reads: each topic's times (ns) and columns."""
    topics = {}
    for chunk in McapReader(file).stream():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            names = [name.split(":")[-1] for name in batch.schema.names]
            topics[chunk.entity_path] = dict(zip(names, map(values, batch.columns), strict=True))
    return topics


def messages(file, topic):
    return [each[0] for each in columns(file)[topic]["message"]]


def pictures(topic):
    """Images (T, R, C) of an entity in Rerun."""
    form = topic["format"][0][0]
    data = np.array([each[0] for each in topic["buffer"]], np.uint8)
    return data.view("<f4").reshape(len(data), form["height"], form["width"])


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    """A bag of a layout that is not a grid, uncalibrated, and its arrays."""
    folder = tmp_path_factory.mktemp("hand")
    (folder / "hand.toml").write_text(GRASP)
    log = recording.path("book_1")
    with np.load(exported(log, folder / "hand.toml", folder / "a.npz")) as file:
        arrays = {**file}
    return arrays, bag(log, folder / "hand.toml", folder / "hand")


def test_a_bag_holds_the_images_of_every_frame_at_its_time(tmp_path, config, lossy):
    npz = npz_arrays(lossy, config, tmp_path / "a.npz")
    file = bag(lossy, config, tmp_path / "grasp")
    check_mcap(file)
    got = columns(file)
    assert {*got} == {f"/palm/{name}" for name in PALM} | {"/diagnostics"}
    times = [round(each * 1e9) for each in npz["time"].tolist()]
    for name in ("raw", "restored"):
        np.testing.assert_array_equal(pictures(got[f"/palm/{name}"]), npz[name])
        for clock in ("message_log_time", "ros2_timestamp"):
            assert got[f"/palm/{name}"][clock] == times
    arrays = messages(file, "/palm/tactile")
    np.testing.assert_array_equal([each["raw"] for each in arrays], npz["raw"].reshape(len(arrays), -1))
    np.testing.assert_array_equal([each["flags"] for each in arrays], npz["flags"].reshape(len(arrays), -1))
    assert np.isnan(arrays[7]["raw"]).sum() == 41 == np.count_nonzero(np.array(arrays[7]["flags"]) & MISSING)
    assert [each["sequence"] for each in arrays] == npz["sequence"].tolist()
    assert (arrays[0]["pressure_unit"], arrays[0]["force_unit"]) == ("kPa", "N")
    np.testing.assert_allclose([each["force"] for each in arrays], 1e-3 * npz["restored"].sum((1, 2)), atol=1e-5)


def test_every_contact_has_a_wrench_whose_moment_is_that_of_its_place(tmp_path, config, lossy):
    file = bag(lossy, config, tmp_path / "grasp")
    contacts = [each for array in messages(file, "/palm/tactile") for each in array["contacts"]]
    wrenches = [each["wrench"] for each in messages(file, "/palm/wrench")]
    assert len(contacts) == len(wrenches) > 20
    for contact, wrench in zip(contacts, wrenches, strict=True):
        place = [1e-3 * contact["x_mm"], 1e-3 * contact["y_mm"], 0.0]
        force, torque = ([each[axis] for axis in "xyz"] for each in (wrench["force"], wrench["torque"]))
        np.testing.assert_allclose(force, [0, 0, contact["force"]], rtol=1e-6)
        np.testing.assert_allclose(torque, np.cross(place, force), rtol=1e-6)
    last = contacts[-1]
    assert last["force"] == pytest.approx(1.4, abs=0.1)  # four taxels of 1 mm2 at 350 kPa
    assert (last["x_mm"], last["y_mm"]) == pytest.approx((3.5, 4.5), abs=0.05)
    assert 0.001 < last["force_deviation"] < 0.7


def test_what_the_sensor_s_regions_hold_has_a_topic(tmp_path, config, lossy, keep_regions):
    keep_regions(heel=HEEL)
    file = bag(lossy, config, tmp_path / "grasp")
    heels = pictures(columns(file)["/palm/restored"])[:, :, :4].astype(float)
    got = messages(file, "/palm/regions")
    names = {(each["pressure_unit"], each["force_unit"], each["regions"][0]["name"]) for each in got}
    assert names == {("kPa", "N", "heel")}
    for name, values in (("force", heels.sum((1, 2)) * 1e-3), ("peak", heels.max((1, 2)))):
        np.testing.assert_allclose([each["regions"][0][name] for each in got], values, rtol=1e-5, atol=1e-6)


def test_the_place_of_the_array_is_a_static_transform(tmp_path, config, lossy):
    config.write_text(config.read_text().replace("pitch_mm = 1.0", PLACE))
    got = columns(bag(lossy, config, tmp_path / "grasp"))["/tf_static"]
    (parent,), (shift,), (rotation,) = (got[key] for key in ("parent_frame", "translation", "quaternion"))
    assert parent == ["hand"]
    np.testing.assert_allclose(shift, [np.multiply(1e-3, ORIGIN_MM)], rtol=1e-6)
    np.testing.assert_allclose(rotation, [ORIENTATION], rtol=1e-6)


def test_warnings_and_loss_are_diagnostics_when_they_change(tmp_path, config, lossy):
    file = bag(lossy, config, tmp_path / "grasp")
    states = [each["status"][0] for each in messages(file, "/diagnostics")]
    missing = next(each for each in states if "missing" in {pair["key"] for pair in each["values"]})
    assert (missing["level"], missing["hardware_id"]) == (1, "can0")
    assert "41 taxels" in missing["message"]
    lost = [int(pair["value"]) for each in states for pair in each["values"] if pair["key"] == "lost so far"]
    assert (lost[0], lost[-1]) == (0, 3)
    assert len(states) < 20  # of 60 frames in 0.6 s


def test_an_uncalibrated_layout_is_a_picture_in_counts_without_wrenches(layout):
    npz, file = layout
    got = columns(file)
    assert {*got} == {f"/hand/{name}" for name in PALM - {"wrench"}} | {"/diagnostics"}
    (where,) = messages(file, "/hand/layout")
    places = np.column_stack([where["x_mm"], where["y_mm"]])
    np.testing.assert_allclose(places, npz["positions_mm"], atol=1e-3)
    assert messages(file, "/hand/tactile")[0]["pressure_unit"] == "counts"
    for name, at in (("raw", places), ("restored", npz["cells_mm"])):
        images = pictures(got[f"/hand/{name}"])
        column, row = np.rint((at - where[f"{name}_corner_mm"]) / where[f"{name}_pixel_mm"]).astype(int).T
        np.testing.assert_array_equal(images[:, row, column], npz[name].reshape(len(images), -1))
        assert np.isnan(images).any()  # between the fingers


def test_the_file_is_sound_and_defines_its_messages(layout):
    _, file = layout
    with file.open("rb") as opened:
        reader = mcap.reader.make_reader(opened, validate_crcs=True)
        assert len(list(reader.iter_messages())) == reader.get_summary().statistics.message_count
        schemas = {each.name: each.data.decode() for each in reader.get_summary().schemas.values()}
    for name, bit in FLAG_BITS.items():
        assert f"uint8 {name}={bit}\n" in schemas["tactiled_msgs/msg/TactileArray"]
    with AnyReader([file.parent]) as reader:  # by metadata.yaml, and by these definitions
        qos = {each.topic: each.ext.offered_qos_profiles[0] for each in reader.connections}
        assert {reader.deserialize(data, each.msgtype).header.frame_id for each, _, data in reader.messages()
                if each.topic == "/hand/tactile"} == {"hand"}  # fmt: skip
    about = yaml.safe_load((file.parent / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert about.keys() == METADATA
    for each in about["topics_with_message_count"]:
        assert each["topic_metadata"].keys() == TOPIC
        (profile,) = yaml.safe_load(each["topic_metadata"]["offered_qos_profiles"])  # a text before version 9
        assert profile.keys() == QOS
        assert {type(profile[key]) for key in ("history", "reliability", "durability", "liveliness")} == {int}
    reliability = [qos[f"/hand/{name}"].reliability.name for name in ("raw", "restored")]
    assert reliability == ["BEST_EFFORT", "RELIABLE"]
    assert qos["/hand/layout"].durability.name == "TRANSIENT_LOCAL"
    check = subprocess.run([Path(sys.executable).with_name("rerun"), "mcap", "check", "--full", file],
                           capture_output=True, text=True)  # fmt: skip
    assert check.returncode == 0, check.stdout


def test_the_same_export_is_the_same_bag_and_sqlite3_holds_the_same_messages(tmp_path, config, lossy):
    (tmp_path / "again").mkdir()
    one, other = bag(lossy, config, tmp_path / "grasp"), bag(lossy, config, tmp_path / "again" / "grasp")
    assert one.read_bytes() == other.read_bytes()
    bag(lossy, config, tmp_path / "old", "rosbag2-sqlite3")
    with one.open("rb") as file:
        messages = mcap.reader.make_reader(file).iter_messages(log_time_order=False)
        rows = [(channel.topic, each.log_time, each.data) for _, channel, each in messages]
    with sqlite3.connect(tmp_path / "old" / "old.db3") as old:
        join = (
            "select name, timestamp, data from messages join topics on topic_id = topics.id order by messages.id"
        )
        assert old.execute(join).fetchall() == rows
        assert old.execute("select schema_version from schema").fetchall() == [(4,)]  # sqlite_storage.hpp, 0.24 on
    old.close()


@pytest.mark.parametrize("to", ["rosbag2", "rosbag2-sqlite3"])
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, config, lossy, to, monkeypatch):
    full = sqlite3.OperationalError("database or disk is full") if "sql" in to else OSError(28, "No space left")
    monkeypatch.setattr("rosbags.rosbag2.Writer.write", Mock(side_effect=full))
    before = sorted(tmp_path.iterdir())
    message = refusal("export", lossy, "--config", config, "-o", tmp_path / "grasp", "--to", to)
    assert message.endswith(("disk is full: nothing is written", "No space left: nothing is written"))
    assert sorted(tmp_path.iterdir()) == before


def test_formats_are_named(tmp_path, config, lossy, monkeypatch):
    message = refusal("export", lossy, "--config", config, "-o", tmp_path / "grasp", "--to", "rosbag")
    assert message.startswith("--to rosbag: unsupported format; use .npz, ")
    monkeypatch.setattr("tactiled.archive.writers.find_spec", lambda _: None)
    message = refusal("export", lossy, "--config", config, "-o", tmp_path / "grasp", "--to", "rosbag2")
    assert "rosbag2 needs rosbags: pip install 'tactiled[ros]'" in message


@pytest.mark.parametrize(("name", "topic"), [("palm", "palm"), ("left-hand", "left_hand"), ("7th", "sensor_7th")])
def test_names_of_topics_are_those_that_ros_takes(name, topic):
    assert ros_name(name) == topic
