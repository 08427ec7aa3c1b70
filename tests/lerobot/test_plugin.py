"""The plug-in for LeRobot, by the functions of LeRobot's own command to record."""

import asyncio
import importlib
import re
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import make_dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.errors import TactileError
from tactiled.live.sensor import Sensor
from tests.conftest import BUSY_S, pressed, until
from tests.lerobot.stand_ins import stand_ins

FRAMES = "utils.feature_utils" if sys.version_info >= (3, 12) else "datasets.utils"  # of LeRobot 0.6, and of 0.4
MODULES = "robots", "processor", FRAMES, "datasets.pipeline_features", "utils.import_utils"


@pytest.fixture(scope="module")
def lerobot():
    """LeRobot's functions, after it has looked for plug-ins where deploy/venv installs both."""
    paths = Path(__file__).parents[2] / "deploy/lerobot", Path(sys.prefix) / "lib/lerobot"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, *map(str, paths)])
        with stand_ins(), warnings.catch_warnings(action="ignore"):
            modules = [importlib.import_module(f"lerobot.{name}") for name in MODULES]
            importlib.import_module("tests.lerobot.arm")
            modules[-1].register_third_party_plugins()
        yield SimpleNamespace(**{name: each for module in modules for name, each in vars(module).items()})


@pytest.fixture
def plugin(lerobot):
    from lerobot_robot_tactiled import features, reader, robot  # LeRobot has found it

    del lerobot
    return SimpleNamespace(**vars(features) | vars(reader) | vars(robot))


@pytest.fixture
def make_robot(lerobot, url, tmp_path):
    """Make the robot as LeRobot does, from options of its command line."""
    if sys.version_info >= (3, 14):
        pytest.skip("draccus 0.11.6, the newest, which reads LeRobot's command line, has no Python 3.14")
    command, made = make_dataclass("Command", [("robot", lerobot.RobotConfig)]), []

    def make(*options, sensors="[palm]"):
        arm = f"{{type: arm, port: /dev/arm, calibration_dir: {tmp_path}}}"
        options += "type=tactiled", f"robot={arm}", f"url={url}", f"sensors={sensors}"
        arguments = [f"--robot.{option}" for option in (*options, f"calibration_dir={tmp_path}")]
        config = importlib.import_module("draccus").parse(command, args=arguments)
        made.append(lerobot.make_robot_from_config(config.robot))
        return made[-1]

    yield make
    for robot in made:
        if robot.is_connected:
            robot.disconnect()
    assert "tactiled" not in {thread.name for thread in threading.enumerate()}


def test_a_recorded_window_is_bit_for_bit_the_last_frames_in_order(lerobot, plugin, rig, make_robot):
    def show():
        return rig.show(pressed(force=300 + rig.sequence))

    def recorded():
        frame = lerobot.build_dataset_frame(features, process(robot.get_observation()), "observation")
        return frame["observation.state"]

    rig.stale_after(600)
    show()
    robot, process = make_robot("frames=3", "max_age_s=600"), lerobot.make_default_robot_observation_processor()
    features = lerobot.aggregate_pipeline_dataset_features(
        process, lerobot.create_initial_features(observation=robot.observation_features)
    )
    assert features.keys() == {"observation.state"}  # no image, which a video would change
    names = features["observation.state"]["names"]
    assert names[0] == "joint.pos"
    with ThreadPoolExecutor(1) as other:
        connecting = other.submit(robot.connect)
        while not connecting.done():
            show()
    connecting.result()
    published = []
    for _ in range(4):
        published.append(show().restored)
        until(lambda: (plugin.arrays(names, recorded())["palm.restored_kPa"][-1] == published[-1]).all())
    arrays = plugin.arrays(names, np.stack([recorded(), recorded()]))  # a batch
    assert arrays["palm.restored_kPa"].dtype == np.float32
    assert arrays["palm.restored_kPa"][1].tobytes() == np.stack(published[-3:]).tobytes()
    assert (np.diff(arrays["palm.age_s"]) < 0).all()
    assert (np.diff(arrays["palm.age_s"], axis=0) >= 0).all()  # of the same frame, read again
    rig.send(pressed(), drop=[0])
    until(lambda: robot.get_observation()["tactile.palm.flagged_taxels.2"] > 0)
    unknown = np.count_nonzero(np.isnan(rig.sensor.hub.latest().restored))
    assert robot.get_observation()["tactile.palm.unknown_cells.2"] == unknown > 0
    assert robot.send_action({"joint.pos": 1.0}) == {"joint.pos": 1.0}


def test_a_frame_from_before_the_connection_has_its_age(rig, make_robot):
    rig.stale_after(600)
    rig.show(pressed())
    time.sleep(0.5)
    robot = make_robot("max_age_s=600")
    robot.connect()
    assert robot.get_observation()["tactile.palm.age_s.0"] >= 0.5


def test_a_frame_of_unknown_age_does_not_count_and_a_newer_one_does(rig, make_robot, monkeypatch):
    """As of a server on Zenoh that has not compared its clock with the reader's yet."""
    status = Sensor.status
    monkeypatch.setattr(Sensor, "status", lambda self: replace(status(self), age_s=None))
    rig.stale_after(600)
    rig.show(pressed())
    robot = make_robot("max_age_s=600")
    with ThreadPoolExecutor(1) as other:
        connecting = other.submit(robot.connect)
        time.sleep(1.0)
        assert not connecting.done(), connecting.exception()
        while not connecting.done():
            rig.show(pressed())
    connecting.result()
    assert robot.get_observation()["tactile.palm.age_s.0"] < BUSY_S


def test_without_new_frames_an_observation_is_an_error_until_they_come_back(rig, make_robot):
    def late():
        try:
            return not robot.get_observation()
        except TimeoutError as error:
            return re.search(r"'palm' has 1/1 frames, the newest [\d.]+ s old: max_age_s = 0\.5", str(error))

    robot = make_robot("max_age_s=0.5")
    with rig.playing(50):
        robot.connect()
    until(late)
    with rig.playing(50):
        until(lambda: not late())


def test_a_sensor_without_images_or_with_others_than_at_first_is_named(rig, plugin, make_robot, monkeypatch):
    monkeypatch.setattr("lerobot_robot_tactiled.robot.FIRST_IMAGE_S", 0.5)
    robot = make_robot(sensors="[plam]")
    for use in (robot.connect, lambda: robot.observation_features):
        with pytest.raises(TactileError, match="sensor 'plam': no such sensor: there are palm"):
            use()
    with pytest.raises(TactileError, match=r"sensor 'palm' at .*: no image for 0.5 s: palm is silent"):
        make_robot().connect()
    assert not robot.is_connected
    rig.stale_after(600)
    rig.show(pressed())
    counts = SimpleNamespace(sensor="palm", unit="counts", restored=np.zeros((8, 8)))
    reader = plugin.Reader(robot._client, {"palm": counts}, 1, 600.0)
    with pytest.raises(TactileError, match=r"images are \('kPa', \(8, 8\)\) now, and were \('counts'"):
        reader.read(BUSY_S)
    reader.stop()


WINDOWS = {  # sequence and time (s) of frames, and what comes of them
    ((5, 10.0), (6, 40.0), (6, 40.0)): "2/2",  # sent again
    ((5, 10.0), (6, 71.0)): "1/2",  # a pause
    ((5, 10.0), (0, 9.0)): "1/2",  # another clock
}


def test_a_window_has_no_frame_twice_and_no_pause(plugin):
    common = {"sensor": "palm", "unit": "kPa", "restored": np.zeros(1), "flags": np.zeros(1), "status": {}}
    for frames, text in WINDOWS.items():
        done, images = threading.Event(), [SimpleNamespace(**common, sequence=n, timestamp=t) for n, t in frames]

        async def astream(_, images=images, done=done):
            for each in images:
                yield each
            done.set()
            await asyncio.sleep(BUSY_S)

        reader = plugin.Reader(SimpleNamespace(astream=astream, url="http://h"), {"palm": images[0]}, 2, 60.0)
        done.wait()
        reader._newest_at["palm"] = -1e9  # that of a machine that hangs: an error shows the frames
        with pytest.raises(TimeoutError, match=f"sensor 'palm' has {text} frames"):
            reader.read(0.0)
        reader.stop()


WRONG = {"robot": [{}, {"type": "tactiled"}], "sensors": [[], ["palm", "palm"]], "frames": [0]}
WRONG["max_age_s"] = [0.0, float("nan")]


def test_a_wrong_setting_is_named_with_its_value(plugin):
    for name, value in ((name, value) for name, each in WRONG.items() for value in each):
        with pytest.raises(ValueError, match=re.escape(f"{name} = {value!r}: give")):
            plugin.TactiledRobotConfig(**{"robot": {"type": "arm"}, "sensors": ["palm"], name: value})
