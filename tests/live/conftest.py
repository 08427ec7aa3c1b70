from dataclasses import replace

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.config import parse
from tactiled.frames import Loss, RawFrame
from tactiled.live.sensor import Sensor
from tests.conftest import CONFIG, SIDE, pressed


@pytest.fixture(scope="session")
def plan():
    """The palm of the tests' configuration: 8 x 8 taxels, no load at 100 counts, 0.5 kPa a count."""
    return sensor_plan("palm", parse(CONFIG.format(channel="none")).sensor["palm"])


def frame(sequence=0, counts=None, flags=None, **fields):
    counts = np.asarray(pressed() if counts is None else counts, np.uint16).ravel()
    flags = np.zeros(SIDE**2, np.uint8) if flags is None else np.asarray(flags, np.uint8).ravel()
    return replace(RawFrame(sequence, 12.5, 0.001, counts, flags, Loss(lost=3)), **fields)


class Timed:
    """A sensor whose clock a test sets."""

    def __init__(self, plan):
        self.now = 100.0
        self.sensor = Sensor(plan, lambda: self.now)
