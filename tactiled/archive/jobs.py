"""What is done with each of many files: one sensor's frames are restored, on whatever machine."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from threading import get_ident
from typing import Any, Self

from tactiled.build import SensorPlan, configured_file, make_codec, sensor_plan
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.config import schema
from tactiled.frames import CONFIGURED
from tactiled.recorded.offline import Offline, open_frames


@dataclass(frozen=True, eq=False)
class Job(ABC):
    """One sensor of a configuration, without secrets, as it is pickled for workers."""

    name: str
    sensors: Mapping[str, schema.Sensor]  # all that are on its bus
    calibration: CalibrationFile | None
    config: Mapping[str, Any]  # the configuration with all defaults, for the provenance

    @classmethod
    def of(cls, config: Path, settings: schema.Config, name: str, **options: Any) -> Self:
        """The job of a configuration that stands in a file; `options` are the fields of a kind of job."""
        one = settings.sensor[name]
        sensors = {key: each for key, each in settings.sensor.items() if each.bus == one.bus}
        dump = {"file": config.name} | settings.model_dump(mode="json", exclude={"server"})
        return cls(name, sensors, configured_file(one), dump, **options)

    def plan(self) -> SensorPlan:
        """The sensor's plan, whose cover is solved once for a process and thread."""
        return _plan(self, get_ident())

    def settings(self) -> dict[str, Any]:
        """Everything that outputs depend on except the input and the version (JSON's types)."""
        own = {each.name: getattr(self, each.name) for each in fields(self)}
        own.pop("sensors")  # they are in the configuration
        return own | {
            "job": type(self).__name__,
            "calibration": self.calibration.id if self.calibration else CONFIGURED,
            "codec": sha256(make_codec(self.sensors[self.name]).source).hexdigest(),  # its DBC file, for one
        }

    @abstractmethod
    def make(self, source: Path, part: Path) -> str:
        """Write the output of one file; returns a phrase about it."""


@lru_cache(maxsize=4)
def _plan(job: Job, _: int) -> SensorPlan:
    return sensor_plan(job.name, job.sensors[job.name], job.calibration)


@dataclass(frozen=True, eq=False)
class RestoreJob(Job):
    """Restores the frames of a .npy file into another, by one method."""

    method: str = "auto"
    noise: float | None = None  # of a taxel, in the frames' unit; None: measured

    def offline(self, source: Path) -> Offline:
        """The frames of a file, ready to be restored."""
        return Offline(self.plan(), open_frames(source, self.plan()), self.method, self.noise)

    def make(self, source: Path, part: Path) -> str:
        """Write all images of a file's frames."""
        offline = self.offline(source)
        return self.summary(offline, offline.write(part))

    def summary(self, offline: Offline, methods: Counter[str]) -> str:
        """One phrase of what was restored: shape, noise, frames by method."""
        counts = ", ".join(f"{name} {count}" for name, count in methods.most_common()) or "no frames"
        return f"{' x '.join(map(str, offline.shape))}, noise {offline.noise_kpa:.3g} {self.plan().unit}: {counts}"
