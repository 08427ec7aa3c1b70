"""LeRobot plug-in: restored tactile images of tactiled among the observations of any robot."""

from lerobot_robot_tactiled.features import arrays
from lerobot_robot_tactiled.robot import TactiledRobot, TactiledRobotConfig

__all__ = ["TactiledRobot", "TactiledRobotConfig", "arrays"]
