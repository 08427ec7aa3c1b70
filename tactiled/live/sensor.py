"""One array as it runs: the restoration of its newest frame, its newest image, and its health."""

import threading
import time
from collections.abc import Callable
from math import inf

import numpy as np

from tactiled.arrays import Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.counts.tare import Zero
from tactiled.contacts.detection import DetectedContact
from tactiled.errors import LoadedError, NoShearError, NotLiveError, TareStateError
from tactiled.frames import FrameWarning, RawFrame, SensorImage
from tactiled.geometry import tiling
from tactiled.live.budget import budget_share, default_budget_s
from tactiled.live.contact_search import ContactSearch
from tactiled.live.hand_over import HandOver
from tactiled.live.history import History
from tactiled.live.hub import Hub, Publisher
from tactiled.live.pipeline import Pipeline
from tactiled.live.region_monitor import RegionMonitor
from tactiled.live.status import Health, State, Status
from tactiled.live.timings import Timings
from tactiled.threads import FRAME_LOCK, run_on_thread


class Sensor:
    """One array: its bus's thread or its own restores its newest frame; any may ask for images and health."""

    def __init__(
        self,
        plan: SensorPlan,
        clock: Callable[[], float] = time.monotonic,
        history: tuple[float, int] = (0.0, 0),  # s and bytes of images that are kept
    ) -> None:
        self.plan, self.name, self.codec, self.array = plan, plan.name, plan.codec, plan.array
        self.cells = plan.cells
        self.pipeline, self.hub, self.timings = Pipeline(plan, start=run_on_thread), Hub(), Timings()
        self.frames: Publisher[RawFrame] = Publisher()  # every one in counts, on the bus's thread
        self.sends = Publisher[tuple[SensorImage, float]]()  # each to a client, and when (s): event loop
        self.history = History(*history, plan.array.frame_shape, plan.cells.shape, plan.shears)
        self.regions = RegionMonitor(lambda: self.plan.cells)
        self.health = Health(clock)
        self.hand_over = HandOver(self.name, self._restore_in_time)
        self.budget_share = budget_share(1)  # set by the service, from the number of its sensors
        self.former: tuple[CalibrationFile, ...] = ()  # the newest first; those that were not written
        self._tracking = ContactSearch(plan.name, self.hub, plan.array, plan.cells, self.deviation)
        self._between_frames = threading.Lock()  # is held while a frame is processed
        self._warnings: dict[str, FrameWarning] = {}  # by code, since they were last drained
        self._warnings_lock = threading.Lock()

    @property
    def method(self) -> str:
        """Name of the method that is set."""
        return self.pipeline.method

    @property
    def clock(self) -> str | None:
        """That gives the frames' times; None before the bus was first open."""
        return self.health.clock

    @property
    def newest(self) -> RawFrame | None:
        """The newest frame in counts; its image may not be made yet."""
        return self.health.newest

    @property
    def references(self) -> list[float | None] | None:
        """Counts of the newest frame's pads that feel no pressure, None of a missing one; None: it has none."""
        if (frame := self.newest) is None or frame.references is None:
            return None
        return [None if np.isnan(each) else float(each) for each in frame.references]

    @property
    def areas_mm2(self) -> tuple[float, ...] | None:
        """Areas of the taxels, None: of a grid."""
        return None if self.array.shape else tuple(tiling(self.array).areas.tolist())

    def deviation(self, image: SensorImage) -> Floats32:
        """Standard deviation of every cell of the newest restored image, in its unit."""
        return self.pipeline.deviation(image)

    def surface(self, image: SensorImage) -> Floats32:
        """The newest restored image and its deviation (2, R, C), with what lies beyond the taxels, in its unit."""
        return self.pipeline.surface(image)

    def need_shear(self) -> None:
        """NoShearError where its skin feels none."""
        if not self.plan.shears:
            raise NoShearError(f"sensor {self.name!r}: its codec {self.plan.codec_name} carries no shear")

    def need_traction(self) -> None:
        """NoShearError where its shear is not restored."""
        self.need_shear()
        if not self.plan.restores_shear:
            raise NoShearError(
                f"sensor {self.name!r}: shear is not restored: that needs calibration.shear_n_per_count, "
                "kpa_per_count or a gain, and a cover that does not slide"
            )

    def contacts(self) -> tuple[SensorImage | None, tuple[DetectedContact, ...]]:
        """The newest image and the contacts in it, tracked while anybody asks; any thread."""
        return self._tracking.contacts()

    def tare(self, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array; NotLiveError where none come.

        LoadedError where the newest frames show a load, unless it is by `force`.
        """
        status = self.status()
        if status.state != "live":
            raise NotLiveError(f"sensor {self.name!r}: {status.state}, {status.detail}: a tare needs frames")
        if not force and (load := self.pipeline.load_description()):
            raise LoadedError(
                f"sensor {self.name!r}: {load}: unload the array, or tare anyway with force=true", load
            )
        self.pipeline.tare(time.time(), force)

    def undo_tare(self) -> None:
        """Give up a tare under way, else take the zero from before the last; TareStateError without either."""
        with self._between_frames:
            if not self.pipeline.can_undo:
                raise TareStateError(f"sensor {self.name!r}: no tare to undo")
            self.pipeline.undo_tare()

    def set_zero(self, zero: Zero) -> None:
        """Take a zero from the next frame on."""
        with self._between_frames:
            self.pipeline.set_zero(zero)

    def recalibrate(self, plan: SensorPlan, commit: Callable[[], None]) -> None:
        """Go on by another plan of the same array from the next frame on; not where `commit` fails.

        The new pipeline is made first, so that frames wait for the exchange alone.
        """
        pipeline = Pipeline(plan, self.pipeline, run_on_thread)
        commit()
        with self._between_frames:
            pipeline.take_over(self.pipeline)
            self.plan, self.pipeline = plan, pipeline

    def lapse_tare(self) -> None:
        """Give up a tare under way if frames no longer come: what lies there later is no zero."""
        if self.state != "live":
            self.pipeline.lapse_tare()

    def drain_warnings(self) -> dict[str, FrameWarning]:
        """The newest warning of each code in the images since the last call."""
        with self._warnings_lock:
            warnings, self._warnings = self._warnings, {}
        return warnings

    def start(self) -> None:
        """Start restoring."""
        self.hand_over.start()
        self._tracking.start()

    def stop(self) -> None:
        """Stop restoring; returns when its threads have ended."""
        self.hand_over.stop()
        self._tracking.stop()

    def offer(self, frame: RawFrame, wake: bool = True) -> None:
        """Take a new frame; its own thread restores it, or without `wake` the caller, by `hand_over.take_turn`."""
        self.hand_over.offer(frame, self._note_arrival(frame), wake)

    def restore(self, frame: RawFrame) -> None:
        """Restore a frame at once, on the caller's thread, so that none is skipped: for recordings."""
        now = self._note_arrival(frame)
        self.hand_over.loss = frame.loss
        self._publish(frame, inf, (now, now))

    def note_send(self, image: SensorImage) -> None:
        """A client is sent an image now; on the event loop."""
        now = time.monotonic()
        self.timings.note_send(image, now)
        self.sends.publish((image, now))

    def _note_arrival(self, frame: RawFrame) -> float:
        """A frame comes now: the time (s)."""
        now, after_break = self.health.note_arrival(frame, self.plan.stale_after_s)
        if after_break:
            self.pipeline.lapse_tare()
        self.frames.publish(frame)
        return now

    def _restore_in_time(self, frame: RawFrame, assembled: float) -> None:
        self._publish(frame, self._budget_s(), (frame.arrived, assembled))

    def _budget_s(self) -> float:
        """Time for restoring a frame."""
        if self.plan.budget_s is not None:
            return self.plan.budget_s
        return default_budget_s(self.health.period_s, self.budget_share)

    def _publish(self, frame: RawFrame, budget_s: float, came: tuple[float, float]) -> None:
        """Publish one image; a frame that cannot be restored ends neither the thread nor the service.

        `came` is when it arrived and was assembled (s).
        """
        try:
            with self._between_frames, FRAME_LOCK:
                image = self.pipeline.process(frame, budget_s, came)
            self.regions.watch(image)
            self.hub.publish(image)
            self.timings.note(image, time.monotonic())
            self.history.keep(image)
            if image.warnings:
                with self._warnings_lock:
                    self._warnings.update((each.code, each) for each in image.warnings)
            self.health.failure = None
        except Exception as error:
            self.health.failure = f"restoration failed: {type(error).__name__}: {error}"

    def status(self) -> Status:
        """Health at this moment."""
        waits = self.hand_over
        return self.health.status(self.plan, waits.loss, waits.skipped, self.pipeline.zero.time)

    @property
    def state(self) -> State:
        """State of `status`, at less cost."""
        return self.health.judge(self.plan)[0]
