"""All frames of one sensor out of a recording, in counts, for a calibration."""

from pathlib import Path

import numpy as np

from tactiled.build import make_codec
from tactiled.bus.recording import Recording
from tactiled.bus.replay import AT_ONCE, frames
from tactiled.bus.router import Router
from tactiled.calibrate.counts.frame_series import FrameSeries
from tactiled.config import Config
from tactiled.errors import ConfigError
from tactiled.frames import BAD, MISSING


def read_frame_series(path: Path, name: str, config: Config) -> FrameSeries:
    """Every frame of sensor `name` (which `config` has), NaN where a taxel is missing or bad.

    Where the recording's clock steps back, all times are instead those since its first message, steps left out.
    ConfigError where the recording cannot be read or holds no frame of the sensor.
    """
    bus = config.sensor[name].bus
    router = Router({key: make_codec(each) for key, each in config.sensor.items() if each.bus == bus})
    recording, times, arrived, counts = Recording(path, router.ids), [], [], []
    for sensor, frame in frames(recording, router, AT_ONCE):
        if sensor == name:
            times.append(frame.time)
            arrived.append(frame.arrived)
            valid = frame.flags & (MISSING | BAD) == 0
            counts.append(np.where(valid, frame.counts, np.nan).astype(np.float32))
    if not times:
        raise ConfigError(f"recording {path}: holds no frame of sensor {name} ({recording.summary()})")
    ascending = bool((np.diff(times) >= 0).all())
    return FrameSeries(np.array(times if ascending else arrived, np.float64), np.stack(counts))
