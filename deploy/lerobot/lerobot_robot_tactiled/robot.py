"""A robot of LeRobot that adds tactile images to the observations of another robot."""

import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import draccus
from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_tactiled.features import value_names
from lerobot_robot_tactiled.reader import Reader
from tactiled.client import Image, connect

FIRST_IMAGE_S = 5.0  # that the first image of a sensor, or the first full window, may take


@RobotConfig.register_subclass("tactiled")
@dataclass(kw_only=True)
class TactiledRobotConfig(RobotConfig):
    """Any robot, and the tactile sensors on it; ValueError names a wrong setting."""

    robot: dict[str, Any]  # `type` and settings of the robot; draccus allows no RobotConfig inside another
    sensors: list[str]  # names in the service
    url: str = "http://127.0.0.1:8000"  # of the service
    frames: int = 1  # in the window of each sensor
    max_age_s: float = 0.2  # of the newest frame, and from one frame of a window to the next

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, right, hint in (
            ("robot", self.robot.get("type") not in (None, self.type), "type and settings of the robot itself"),
            ("sensors", self.sensors and len(set(self.sensors)) == len(self.sensors), "one or more, each once"),
            ("frames", self.frames >= 1, "1 or more"),
            ("max_age_s", 0 < self.max_age_s < float("inf"), "a time above 0 s"),
        ):
            if not right:
                raise ValueError(f"{name} = {getattr(self, name)!r}: give {hint}")


def _of_robot(name: str) -> Any:
    return property(lambda self: getattr(self.robot, name))


class TactiledRobot(Robot):
    """Another robot, with its own actions and observations, and tactile images beside these."""

    config_class = TactiledRobotConfig
    name = "tactiled"
    cameras = _of_robot("cameras")
    action_features = _of_robot("action_features")
    is_connected = _of_robot("is_connected")  # also without images: it is still to be disconnected
    is_calibrated = _of_robot("is_calibrated")
    calibrate = _of_robot("calibrate")
    configure = _of_robot("configure")
    send_action = _of_robot("send_action")

    def __init__(self, config: TactiledRobotConfig) -> None:
        super().__init__(config)
        self.config, self._client = config, connect(config.url, os.environ.get("TACTILED_TOKEN"))
        self.robot = make_robot_from_config(draccus.decode(RobotConfig, {"id": config.id} | config.robot))

    @cached_property
    def _first(self) -> dict[str, Image]:
        return {name: next(self._client.stream(name, patience_s=FIRST_IMAGE_S)) for name in self.config.sensors}

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """The other robot's, and a float for each tactile value; TactileError without images of all sensors."""
        names = [name for image in self._first.values() for name in value_names(image, self.config.frames)]
        return self.robot.observation_features | dict.fromkeys(names, float)

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Look for all sensors, connect the other robot, and wait for full windows of images."""
        first = self._first
        self.robot.connect(calibrate)
        self._reader = Reader(self._client, first, self.config.frames, self.config.max_age_s)
        self._reader.read(FIRST_IMAGE_S)

    def get_observation(self) -> dict[str, Any]:
        """The other robot's, and the newest windows of images; TimeoutError if these stay too old."""
        return self.robot.get_observation() | self._reader.read(self.config.max_age_s)

    @check_if_not_connected
    def disconnect(self) -> None:
        """Disconnect the other robot, and receive no more images."""
        try:
            self.robot.disconnect()
        finally:
            self._reader.stop()
