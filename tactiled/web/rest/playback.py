"""`/api/v1/recordings/{name}/playback` and `/frames`: any frame of a recording, raw and restored, in any order."""

import time
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock, Timer
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from fastapi import Path as PathParameter
from pydantic import Field

from tactiled.frames import Loss, SensorImage
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.recorded.frames import RecordedFrames
from tactiled.recorded.noise import are_all
from tactiled.recorded.playback import Playback, noise_frames
from tactiled.recorded.series import SeriesRuns
from tactiled.units import FORCE_UNITS, ForceUnit, if_calibrated
from tactiled.web import answers, schemas
from tactiled.web.http.problems import SOON, Problem
from tactiled.web.rest import recorded_series
from tactiled.web.rest.dependencies import in_turn, without_path
from tactiled.web.rest.openapi import EVERY_RESOURCE, MEDIA, problems, success
from tactiled.web.rest.recorded_series import SensorQuery, SeriesQuery
from tactiled.web.rest.recordings import FileName, Recordings
from tactiled.web.rest.regions import RegionMeasures
from tactiled.wire import PRESSURES, Kind, pack

MAX_OPEN = 4  # recordings whose frames are on the disk; the one used longest ago makes room
IDLE_S = 600.0  # after its last request a recording's frames are given up
MAX_FRAMES = 64  # an answer: a second of a screen's paintings
ANSWER_S = 0.15  # of restoring, after which an answer has the frames that are done; seeking is to take 0.3 s
MAX_POSITION_S = 1e9
IMAGES = success(
    "messages of the stream's binary form, the kinds of a frame behind one another",
    "file",
    headers={
        "X-Tactiled-Frame": "number of the first frame in the recording, from 0",
        "X-Tactiled-Positions": "s from the recording's first message to each of the frames",
    },
)

Number = Annotated[int, PathParameter(ge=0, le=1 << 53, description="of the frame, from 0", examples=[512])]


class Played(schemas.Schema):
    """A sensor's part of a recording."""

    name: str = Field(examples=["grasp.log"])
    sensor: schemas.SensorName
    frames: int = Field(description="frames by now", examples=[1025])
    reading: bool = Field(description="whether the file is still being read", examples=[False])
    error: str | None = Field(description="why it was not read to its end", examples=[None])
    caveats: list[str] = Field(
        description="what was left out of it and what is in doubt, once it is read",
        examples=[["left out: 2 error frames"]],
    )
    duration_s: float = Field(0.0, description="position of the last frame", examples=[10.24])
    timestamp: float | None = Field(None, description="Unix time of the first frame, s", examples=[1763712000.25])
    unit: schemas.Unit
    noise: float | None = Field(None, description="standard deviation of a raw taxel, in `unit`", examples=[0.2])
    tared_at: float | None = Field(None, description="Unix time of the tare that is used; null: none")
    calibration: str = Field(description="id of the calibration file, or configured", examples=["configured"])
    force_unit: ForceUnit = Field(examples=["N"])
    positions_s: list[float] = Field([], description="of `force`")
    force: list[float | None] = Field(
        [], description="total of the raw image, lowest and highest of each piece; null: too few taxels are known"
    )


class PlayedRegion(RegionMeasures):
    """What a region of the sensor holds in the restored image."""

    name: str = Field(examples=["heel"])


class FrameContacts(schemas.FrameId):
    """The contacts in one frame of a recording."""

    number: int = Field(description="in the recording, from 0", examples=[512])
    contacts: tuple[schemas.Contact, ...] = Field(description="strongest first, numbered in each frame anew")


class PlayedContacts(schemas.Schema):
    """The contacts in some frames of a recording."""

    force_unit: ForceUnit = Field(examples=["N"])
    frames: list[FrameContacts]


class PlayedFrame(schemas.Restoration, FrameContacts):
    """What is known of one frame of a recording beside its images."""

    position_s: float = Field(description="from the recording's first message", examples=[5.12])
    skew_s: float = Field(description="from the frame's first message to its last", examples=[0.0031])
    method: str = Field(description="method used", examples=["nnls"])
    loss: Loss = Field(description="since the beginning of the recording")
    warnings: tuple[schemas.FrameWarning, ...]
    force_unit: ForceUnit = Field(examples=["N"])
    regions: tuple[PlayedRegion, ...] = Field(description="of the sensor, as live")


class MethodQuery(SensorQuery):
    """How they are restored."""

    method: schemas.MethodName | None = Field(None, description="left out: the one that is selected live")


class SomeFrames(MethodQuery):
    """How many frames."""

    count: int = Field(1, ge=1, le=MAX_FRAMES, description="frames at most; fewer if restoring them takes long")
    step: int = Field(1, ge=1, le=100_000, description="from one frame to the next")


class ContactsQuery(SomeFrames):
    """Which frames."""

    first: int = Field(0, ge=0, le=1 << 53, description="number of the first frame, from 0")


class FramesQuery(SomeFrames):
    """Which frames."""

    first: int | None = Field(
        None, ge=0, le=1 << 53, description="number of the first frame, from 0; without `at`"
    )
    at: float | None = Field(
        None,
        ge=0,
        le=MAX_POSITION_S,
        description="instead of `first`: the last frame that had come at this position, s",
    )
    shear: bool = Field(False, description="whether its shear comes behind raw and restored")
    traction: bool = Field(False, description="whether its shear comes behind these as restored")


class Playbacks:
    """Recordings that are open, and what restores their frames; on one thread at a time."""

    def __init__(self, leave_mb: float) -> None:
        self._leave_mb = leave_mb
        self._open: dict[tuple[str, str], RecordedFrames] = {}  # by file and bus, the one used last at the end
        self._noise_frames, self._restoring = lru_cache(MAX_OPEN)(noise_frames), lru_cache(MAX_OPEN)(Playback)
        self._lock = Lock()  # of what is open
        self._idle: Timer | None = None  # closes unused recordings, while any is open
        self.series = SeriesRuns()

    def recorded(self, path: Path, service: Service, bus: str) -> RecordedFrames:
        """The frames of a file; Problem 503 where it is not there.

        It is read again where it or the bus has changed, or where nothing could be read for a reason that may pass
        and one answer has said so.
        """
        key = path.name, bus
        codecs = {name: each.codec for name, each in service.sensors.items() if each.plan.bus == bus}
        with self._lock:
            recorded = self._open.pop(key, None)
            while len(self._open) >= MAX_OPEN:
                self._open.pop(next(iter(self._open))).close()
            try:
                if recorded and (recorded.answered or not recorded.is_of(codecs)):
                    recorded.close()
                    recorded = None
                self._open[key] = recorded = recorded or RecordedFrames(path, codecs, self._leave_mb)
            except OSError as error:
                if recorded:
                    recorded.close()
                raise Problem(503, f"recording {path.name}: {error.strerror}") from error
            recorded.used_at, recorded.answered = time.monotonic(), recorded.failed
            if self._idle is None:
                self._await_idle(IDLE_S)
        return recorded

    def _await_idle(self, seconds: float) -> None:
        self._idle = Timer(seconds, self._close_idle)
        self._idle.daemon = True
        self._idle.start()

    def _close_idle(self) -> None:
        """Close recordings that no client has used for IDLE_S, and set the timer for the next."""
        with self._lock:
            now = time.monotonic()
            for key in [key for key, each in self._open.items() if now - each.used_at >= IDLE_S]:
                self._open.pop(key).close()
            self._idle = None
            if self._open:
                self._await_idle(min(each.used_at for each in self._open.values()) + IDLE_S - now)

    def playback(self, sensor: Sensor, recorded: RecordedFrames) -> Playback:
        """What restores a sensor's frames, by its present calibration; Problem where there is none yet."""
        need_frame(sensor, recorded, 0)
        measured = self.noise_frames(sensor, recorded)
        if measured is None:
            raise Problem(409, f"recording {recorded.path.name}: its noise is not measured yet", SOON)
        return self._restoring(sensor.plan, sensor.pipeline.zero, recorded, measured)

    def noise_frames(self, sensor: Sensor, recorded: RecordedFrames) -> tuple[int, ...] | None:
        """Numbers of the frames that its noise is measured from; None until all of them are read.

        An image by the noise of some of them would differ from the same frame's later.
        """
        reading = recorded.reading  # first: more may come meanwhile
        count = recorded.count(sensor.name)
        numbers = self._noise_frames(sensor.plan, recorded, count)
        measures = sensor.plan.restores_shear or not sensor.plan.calibration.noise_kpa
        return None if reading and measures and not are_all(numbers, count) else numbers

    def close(self) -> None:
        """Close all."""
        self.series.close()
        with self._lock:
            if self._idle:
                self._idle.cancel()
            while self._open:
                self._open.popitem()[1].close()


def need_frame(sensor: Sensor, recorded: RecordedFrames, number: int) -> None:
    """Problem 409 where a frame was not read yet, 404 where there is none."""
    count, name = recorded.count(sensor.name), recorded.path.name
    if number < count:
        return
    if recorded.reading:
        raise Problem(409, f"recording {name}: frame {number} is not read yet", SOON)
    why = without_path(recorded.error, recorded.path) or f"it has {count} frames of sensor {sensor.name}"
    raise Problem(404, f"recording {name}: no frame {number}: {why}")


def _number_at(sensor: Sensor, recorded: RecordedFrames, position_s: float) -> int:
    """Number of the last frame that had come at a position. Problem 409 where that is not read yet.

    There must be a frame.
    """
    reading = recorded.reading  # first: more may come meanwhile
    (last,) = recorded.heads(sensor.name, recorded.count(sensor.name) - 1, 1)
    if reading and position_s > last["position"]:
        raise Problem(409, f"recording {recorded.path.name}: position {position_s:g} s is not read yet", SOON)
    return recorded.at(sensor.name, position_s)


def _state(playbacks: Playbacks, sensor: Sensor, recorded: RecordedFrames) -> Response:
    """A sensor's part of a recording, as far as it was read."""
    reading, plan = recorded.reading, sensor.plan  # first: more may come meanwhile
    fields: dict[str, Any] = {
        "name": recorded.path.name, "sensor": sensor.name, "reading": reading, "unit": plan.unit,
        "force_unit": FORCE_UNITS[plan.unit], "calibration": plan.calibration_id,
        "error": without_path(recorded.error, recorded.path) or None,
        "caveats": recorded.caveats,
    }  # fmt: skip
    frames = recorded.count(sensor.name)
    if frames and playbacks.noise_frames(sensor, recorded) is None:
        frames = 0
    if frames:
        playback = playbacks.playback(sensor, recorded)
        positions, force = playback.overview()
        first, last = (recorded.heads(sensor.name, n, 1)[0] for n in (0, frames - 1))
        fields |= {"duration_s": float(last["position"]), "timestamp": float(first["time"])}
        fields |= {"noise": playback.noise, "tared_at": playback.tared_at}
        fields |= {"positions_s": positions.tolist(), "force": force.tolist()}
    return Response(Played(**fields, frames=frames).model_dump_json(), media_type=MEDIA["json"])


def _restored(
    sensor: Sensor, recorded: RecordedFrames, playback: Playback, query: SomeFrames, first: int
) -> Iterator[tuple[int, SensorImage]]:
    """Some frames from the first on, each with its number, until ANSWER_S have passed."""
    need_frame(sensor, recorded, first)
    last, end = min(recorded.count(sensor.name), first + query.count * query.step), time.monotonic() + ANSWER_S
    for number in range(first, last, query.step):
        yield number, playback.image(number, query.method or sensor.method)
        if time.monotonic() > end:
            return


def _images(playbacks: Playbacks, query: FramesQuery, sensor: Sensor, recorded: RecordedFrames) -> Response:
    """Messages of some frames."""
    kinds: tuple[Kind, ...] = PRESSURES
    if query.shear:
        sensor.need_shear()
        kinds = (*kinds, "shear")
    if query.traction:
        sensor.need_traction()
        kinds = (*kinds, "traction")
    playback = playbacks.playback(sensor, recorded)
    first = _number_at(sensor, recorded, query.at or 0.0) if query.first is None else query.first
    messages, positions = [], []
    for _, image in _restored(sensor, recorded, playback, query, first):
        messages += [pack(image, kind, time.time()) for kind in kinds]
        positions.append(f"{image.arrived:.6f}")
    headers = {"X-Tactiled-Frame": str(first), "X-Tactiled-Positions": ",".join(positions)}
    return Response(b"".join(messages), media_type=MEDIA["file"], headers=headers)


def _contacts(playbacks: Playbacks, query: ContactsQuery, sensor: Sensor, recorded: RecordedFrames) -> Response:
    """Contacts in some frames."""
    playback = playbacks.playback(sensor, recorded)
    frames = [
        FrameContacts(
            number=number,
            sequence=image.sequence,
            timestamp=image.time,
            contacts=answers.listed(playback.contacts(image), image.unit),
        )
        for number, image in _restored(sensor, recorded, playback, query, query.first)
    ]
    found = PlayedContacts(force_unit=FORCE_UNITS[sensor.plan.unit], frames=frames)
    return Response(found.model_dump_json(), media_type=MEDIA["json"])


def _frame(
    playbacks: Playbacks, number: int, method: str | None, sensor: Sensor, recorded: RecordedFrames
) -> Response:
    """What is known of one frame beside its images."""
    need_frame(sensor, recorded, number)
    playback, method = playbacks.playback(sensor, recorded), method or sensor.method
    image = playback.image(number, method)
    fields = {
        "number": number,
        "timestamp": image.time,
        "position_s": image.arrived,
        "skew_s": float(recorded.heads(sensor.name, number, 1)[0]["skew"]),
        "noise_kpa": if_calibrated(image.noise, image.unit),
        "warnings": playback.warnings(number, method),
        "force_unit": FORCE_UNITS[image.unit],
        "contacts": answers.listed(playback.contacts(image), image.unit),
        "regions": [
            PlayedRegion(name=name, **each.measure(image)._asdict())
            for name, each in sensor.regions.series.items()
        ],
    }
    return Response(PlayedFrame(**PlayedFrame.shared(image) | fields).model_dump_json(), media_type=MEDIA["json"])


def _series(playbacks: Playbacks, query: SeriesQuery, sensor: Sensor, recorded: RecordedFrames) -> Response:
    """Values of its frames over the whole recording."""
    playback = playbacks.playback(sensor, recorded)
    return recorded_series.answer(playbacks.series, query, sensor, recorded, playback)


def make(recordings: Recordings, playbacks: Playbacks) -> APIRouter:
    """The routes of the recordings of a folder."""
    router = APIRouter(prefix="/api/v1/recordings/{name}", tags=["recordings"])
    faults = problems(*EVERY_RESOURCE, 404, 409, 429, 503)

    async def answer(
        request: Request, name: str, query: SensorQuery, make: Callable[[Sensor, RecordedFrames], Response]
    ) -> Response:
        service: Service = request.app.state.service
        sensor = service.sensor(query.sensor)

        def made() -> Response:
            return make(sensor, playbacks.recorded(recordings.ended(name), service, sensor.plan.bus))

        return await in_turn(request, made, "playback")

    @router.get("/playback", response_model=Played, responses=faults)
    async def state(name: FileName, request: Request, query: Annotated[SensorQuery, Query()]) -> Response:
        """Get a sensor's part of a recording that does not run; the first request begins to read the file."""
        return await answer(request, name, query, partial(_state, playbacks))

    @router.get("/frames", response_class=Response, responses=faults | IMAGES)
    async def frames(name: FileName, request: Request, query: Annotated[FramesQuery, Query()]) -> Response:
        """Get frames of a recording, raw and restored, each by itself, requested in any order."""
        if query.first is not None and query.at is not None:
            raise Problem(422, "first and at: give one of them")
        return await answer(request, name, query, partial(_images, playbacks, query))

    @router.get("/contacts", response_model=PlayedContacts, responses=faults)
    async def contacts(name: FileName, request: Request, query: Annotated[ContactsQuery, Query()]) -> Response:
        """Get the contacts in frames of a recording."""
        return await answer(request, name, query, partial(_contacts, playbacks, query))

    @router.get("/frames/{number}", response_model=PlayedFrame, responses=faults)
    async def frame(
        name: FileName, number: Number, request: Request, query: Annotated[MethodQuery, Query()]
    ) -> Response:
        """Get reason, warnings, losses and contacts of one frame of a recording."""
        return await answer(request, name, query, partial(_frame, playbacks, number, query.method))

    csv = success("every frame, once all are measured", "csv")

    @router.get("/series", response_model=recorded_series.PlayedSeries, responses=faults | csv)
    async def series(name: FileName, request: Request, query: Annotated[SeriesQuery, Query()]) -> Response:
        """Get force, mean, peak and contact area over a recording; the first request begins to measure."""
        return await answer(request, name, query, partial(_series, playbacks, query))

    return router
