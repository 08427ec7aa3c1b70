"""Record and read back an episode by the whole LeRobot, and compare: `python tests/lerobot/record.py URL SENSOR`.

For an environment with LeRobot, the plug-in and the client, which is gigabytes; the service runs in its own.
"""

import sys
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import arm  # noqa: F401  # registers the robot `arm`; this folder is first in the path
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.pipeline_features import aggregate_pipeline_dataset_features, create_initial_features
from lerobot.processor import make_default_processors
from lerobot.robots import make_robot_from_config
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_robot_tactiled import TactiledRobotConfig, arrays

FRAMES, FPS = 20, 20


def record(url, sensor, folder):
    """The observations that an episode was made of, as `lerobot-record` makes it, and its names."""
    robot = make_robot_from_config(
        TactiledRobotConfig(robot={"type": "arm", "port": "-"}, sensors=[sensor], url=url, calibration_dir=folder)
    )
    action, _, observation = make_default_processors()
    features = {
        **aggregate_pipeline_dataset_features(action, create_initial_features(action=robot.action_features)),
        **aggregate_pipeline_dataset_features(
            observation, create_initial_features(observation=robot.observation_features)
        ),
    }
    dataset = LeRobotDataset.create("tactiled/test", FPS, features, folder / "set", "tactiled", use_videos=False)
    robot.connect()
    names, seen = features["observation.state"]["names"], []
    try:
        for _ in range(FRAMES):
            values = observation(robot.get_observation())
            seen.append(np.array([values[name] for name in names], np.float32))
            dataset.add_frame(
                {"observation.state": seen[-1], "action": np.array([0.25], np.float32), "task": "press"}
            )
        dataset.save_episode()
    finally:
        dataset.finalize()
        robot.disconnect()
    return np.stack(seen), names


def main(url, sensor):
    with TemporaryDirectory() as name:
        register_third_party_plugins()
        seen, names = record(url, sensor, Path(name))
        dataset = LeRobotDataset("tactiled/test", Path(name) / "set")
        read = np.stack([np.asarray(dataset[index]["observation.state"]) for index in range(len(dataset))])
        assert list(dataset.meta.features["observation.state"]["names"]) == list(names)
        assert read.tobytes() == seen.tobytes()
        images = arrays(names, read)
        shapes = {name: each.shape for name, each in images.items()}
        assert np.ptp(images[f"{sensor}.age_s"]) > 0
        print(f"LeRobot {version('lerobot')}, NumPy {np.__version__}: bit for bit as observed: {shapes}")


if __name__ == "__main__":
    main(*sys.argv[1:])
