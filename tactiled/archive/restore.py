"""Frames from .npy file to .npy file."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tactiled.archive.job import Job
from tactiled.runtime.offline import Offline, open_frames


@dataclass(frozen=True, eq=False)
class RestoreJob(Job):
    """Restores the frames of a file by one method."""

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
