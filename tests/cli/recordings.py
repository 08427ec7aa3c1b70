"""A sensor and recordings of it."""

import can
import numpy as np

from tactiled.build import make_codec
from tactiled.bus.recorder import Recorder
from tactiled.config import parse
from tactiled.contacts.regions import Region
from tactiled.frames import Message

CONFIG = """
[bus.can0]
interface = "socketcan"
channel = "gone0"
fd = true

[sensor.palm]
bus = "can0"
method = "auto"
codec = { name = "packed", bits = 12, fd = true }
array = { rows = 8, columns = 8, pitch_mm = 1.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.5, no_load = 100, saturation = 4000 }
"""
HEEL = Region(shape="rectangle", points_mm=[[-0.5, -0.5], [3.5, 7.5]])  # four of eight columns, pitch 1 mm
FRAMES = 60
CODEC = make_codec(parse(CONFIG).sensor["palm"])


def counts(sequence, rng):
    frame = np.full((8, 8), 100.0) + rng.normal(0, 2, (8, 8))
    if sequence > 35:  # the noise is measured before
        at = 1 + sequence % 4
        frame[at : at + 2, 3:5] += 700
    return frame.clip(0, 4095).astype(np.uint16).ravel()


def traffic(missing=()):
    """Moving presses at 100 Hz, foreign messages between; `missing` are (sequence, segment) that never came."""
    rng = np.random.default_rng(1)
    for sequence in range(FRAMES):
        when = 1.6e9 + sequence * 0.01
        for segment, each in enumerate(CODEC.encode(counts(sequence, rng), sequence, when)):
            if (sequence, segment) not in missing:
                yield each._replace(time=when + segment * 0.001)
        yield Message(when + 0.005, 0x77, b"\x01")


def write(path, messages):
    recorder = Recorder(path)
    for each in messages:
        fd = {"is_fd": each.fd, "bitrate_switch": each.fd}
        recorder.put(can.Message(each.time, each.id, is_extended_id=each.extended, data=each.data, **fd))
    recorder.close()
    return path
