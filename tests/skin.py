"""A 3-axis skin on a virtual bus, two rows of three taxels, the last one dead; and the other end of that bus."""

import re
import time

import numpy as np

from tactiled.bus.codecs.xela import REST
from tests.conftest import Rig, meanwhile, until

CONFIG = """
[bus.can0]
interface = "virtual"
channel = "{channel}"
[sensor.skin]
bus = "can0"
method = "raw"
stale_after_s = 600
codec = {{ name = "xela", rows = [0, 1], columns = [0, 1, 2] }}
array = {{ rows = 2, columns = 3, pitch_mm = 4.0 }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.001, dead = [5] }}
"""
PALM = """
[sensor.palm]
bus = "can0"
method = "raw"
codec = { name = "packed", bits = 12, fd = true }
array = { rows = 4, columns = 4, pitch_mm = 1.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5 }
"""  # feels none
TIP = PALM.replace("palm", "tip").replace("fd = true", "fd = true, array_id = 1")
SCALE = ", no_load = 36864, noise_kpa = 0.1, shear_n_per_count = 0.000016"  # of shear
X, Y = np.array([100, -200, 0, 1388, -1388, 7]), np.array([1, 2, 3, 4, 5, 6])
Z = np.full(6, 0x9000)


def messages(codec, x, y, z=Z, now=0.0):
    """A frame (6,) of counts, x and y from rest, on the bus."""
    for at, each in enumerate(codec.encode(np.asarray(z, np.uint16), 0, now)):
        axes = np.array([REST + x[at], REST + y[at]], ">u2").tobytes()
        yield each._replace(data=each.data[:1] + axes + each.data[5:])


class Skin(Rig):
    """The service, and who plays the skin."""

    def __init__(self, channel, more="", scale=""):
        super().__init__(channel, more, CONFIG.replace("dead = [5]", f"dead = [5]{scale}"))

    def show(self, x, y, z=Z, drop=()):
        """Send a frame until it is whole, or as whole as it can be, and served; gives its image."""
        before = self.sensor.hub.latest().sequence if self.sensor.hub.latest() else -1
        for at, each in enumerate(messages(self.sensor.codec, x, y, z, time.time())):
            if at not in drop:
                self.bus.send(each)
        until(lambda: (image := self.sensor.hub.latest()) and image.sequence > before)
        return self.sensor.hub.latest()


def rigged(name, more="", scale=""):
    """A skin that runs meanwhile; `scale` are settings of its shear."""
    return meanwhile(Skin(re.sub(r"\W", "-", name), more, scale))
