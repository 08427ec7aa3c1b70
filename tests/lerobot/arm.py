"""A robot of LeRobot's interface, with one joint."""

from dataclasses import dataclass

from lerobot.robots import Robot, RobotConfig


@RobotConfig.register_subclass("arm")
@dataclass(kw_only=True)
class ArmConfig(RobotConfig):
    port: str


class Arm(Robot):
    config_class, name = ArmConfig, "arm"
    observation_features = action_features = {"joint.pos": float}  # noqa: RUF012
    is_connected, is_calibrated, cameras = False, True, ()

    def connect(self, calibrate=True):
        self.is_connected = calibrate

    def disconnect(self):
        self.is_connected = False

    def get_observation(self):
        return {"joint.pos": 0.25}

    def send_action(self, action):
        return action

    def configure(self):
        pass

    calibrate = configure
