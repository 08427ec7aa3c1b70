"""A sensor whose reader is elsewhere: its images and state as they come, and how old they are; no network."""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from math import inf, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.contacts.detection import DetectedContact
from tactiled.errors import NoShearError, ReaderAnswerError, ReaderError
from tactiled.frames import Loss, SensorImage
from tactiled.geometry import Array, raster, spacing
from tactiled.interop.zenoh import messages
from tactiled.interop.zenoh.session import HEARTBEAT_S, LOST_AFTER_S, Answer, Head, Request
from tactiled.live.contact_search import ContactSearch
from tactiled.live.history import History
from tactiled.live.hub import Hub
from tactiled.live.status import State, Status
from tactiled.live.timings import Timings
from tactiled.units import Unit
from tactiled.wire import HEADER

STOPPED = "its reader was stopped"
NO_LINK = "this server has no connection to the Zenoh network"
SILENT_AFTER_S = 3 * HEARTBEAT_S  # without a message, from which a reader is not believed to be live
Frame = tuple[Head, dict[str, tuple[bytes, bytes]]]  # its messages and their details, by kind
REFUSED_S = 2.5  # that a sensor is stale for after a refused message; states come every second
MAX_SKEW_S = 0.1  # between two clocks, from which an event names it: NTP keeps a local network below 1 ms


@dataclass(frozen=True, slots=True)
class RemotePlan:
    """What a server knows of how a sensor is made."""

    name: str
    bus: str
    codec_name: str
    shears: bool
    unit: Unit
    restores_shear: bool = False  # that it sends on


class ClockOffset:
    """How far a reader's clock is ahead of ours (s), from questions and answers; the quickest answer counts."""

    def __init__(self) -> None:
        self.offset_s: float | None = None  # None: unknown
        self.error_s = inf

    def add(self, start: float, answered: float, received: float) -> None:
        """Take an answer, by the reader's clock, between two times by ours; it may rule out what was known."""
        offset, error = answered - (start + received) / 2, (received - start) / 2
        moved = self.offset_s is None or abs(offset - self.offset_s) > error + self.error_s
        if moved or error <= self.error_s:
            self.offset_s, self.error_s = offset, error

    def __str__(self) -> str:
        ahead = self.offset_s or 0.0
        return f"{abs(ahead):.3f} s {'ahead' if ahead > 0 else 'behind'} (± {1e3 * self.error_s:.1f} ms)"


class Parts:
    """The messages of one session, joined to frames: the newest complete frame waits, no other."""

    def __init__(self) -> None:
        self.number = 0  # of the newest frame of which a message came
        self.lost = 0  # frames that did not come whole, or were overtaken here
        self._first = 0  # number of the first frame
        self._messages: dict[str, tuple[bytes, bytes]] = {}  # of the newest frame, by kind
        self._complete: Frame | None = None
        self._lock = threading.Lock()

    def add(self, head: Head, kind: str, message: bytes, detail: bytes) -> bool:
        """Take a message; whether it completes a frame."""
        with self._lock:
            if head.number < self.number or (head.number == self.number and kind in self._messages):
                return False
            if head.number > self.number:
                if self.number:
                    self.lost += head.number - self.number - 1
                    self.lost += len(self._messages) < head.kinds and self.number != self._first
                else:  # of which a part may have come before we listened
                    self._first = head.number
                self.number, self._messages = head.number, {}
            self._messages[kind] = message, detail
            if len(self._messages) < head.kinds:
                return False
            self.lost += self._complete is not None
            self._complete = head, self._messages
            return True

    def pop(self) -> Frame | None:
        """The newest complete frame, once."""
        with self._lock:
            complete, self._complete = self._complete, None
        return complete


class Line:
    """What comes of one name: which publishers have it, which of them counts, and how it was last heard."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.sessions: dict[str, None] = {}  # whose tokens are there, in the order in which they came
        self.session: str | None = None  # the one that counts; the last one while there is none
        self.parts, self.offset = Parts(), ClockOffset()
        self.lost_before = 0  # in former sessions
        self.heard_at = -inf  # s, monotonic: the newest message of the session
        self.down: str | None = "no reader"  # why there is no session
        self.down_at = -inf  # s, monotonic: since when
        self.closing = False  # whether the reader published that it stops
        self.due = 0.0  # s, monotonic: when its description, then its clock, is asked for
        self.asking = False
        self.described: str | None = None  # the session of which state and geometry came
        self.new_state: bytes | None = None  # that came and is not read yet
        self.refused, self.refused_at = "", -inf  # why, and when (s, monotonic), a message was refused
        self.history_bytes = 0  # for its sensor's past images
        self.state: State = "silent"  # and whether the clock was wrong, when they were last looked at
        self.clock_skewed = False

    @property
    def robot(self) -> str:
        """Its robot's name."""
        return self.name.partition("/")[0]

    @property
    def lost(self) -> int:
        """Frames that were published and not shown here."""
        return self.lost_before + self.parts.lost

    def appear(self, session: str) -> bool:
        """A token comes; whether its publisher counts now, and did not before."""
        self.sessions[session] = None
        if len(self.sessions) > 1:
            return False
        self.down, self.closing = None, False
        return self._take(session)

    def vanish(self, session: str, now: float) -> bool:
        """A token ends at `now` (s, monotonic); whether another publisher counts from now on."""
        self.sessions.pop(session, None)
        if session != self.session or self.down:
            return False
        if self.sessions:
            return self._take(next(iter(self.sessions)))
        silent, self.down_at = now - self.heard_at, now
        if self.closing:
            self.down = STOPPED
        elif silent < LOST_AFTER_S:
            self.down = "its reader has died: its connection was closed"
        else:
            self.down = f"connection to its reader lost: nothing came for {silent:.1f} s"
        return False

    def close(self, closing: bool) -> None:
        """The reader publishes whether it stops; this may come behind the end of its token."""
        self.closing = closing
        if closing and self.down:
            self.down = STOPPED

    def look_at_link(self, linked: bool) -> None:
        """We have a link to the network now, or none: then nothing is known of a reader without a token."""
        if self.down and not linked:
            self.down = NO_LINK
        elif self.down == NO_LINK:
            self.down = "its reader has not come back since this server had no connection"

    def _take(self, session: str) -> bool:
        if session == self.session:
            return False
        self.lost_before += self.parts.lost
        self.session, self.parts, self.offset = session, Parts(), ClockOffset()
        return True


class RemoteSensor:
    """One sensor: what the web reads of it is as of a live one."""

    def __init__(
        self,
        line: Line,
        state: messages.ReportedState,
        geometry: messages.Geometry,
        history: tuple[float, int],
        request: Callable[[Request], Answer],
    ) -> None:
        """`request` has its reader answer a request; `history` is of past images, s and bytes."""
        self._request = request
        self.name, self.line, self.geometry, self.reported = line.name, line, geometry, state
        self.array = Array(
            np.array(geometry.positions_mm, float), geometry.pitch_mm, geometry.aperture_mm, geometry.aperture,
            geometry.shape,
        )  # fmt: skip
        restored = geometry.restored
        refine = round(spacing(self.array) / restored.cell_mm)
        self.cells = raster(self.array, min(max(refine, 1), messages.MAX_REFINE))
        if self.cells.shape != (restored.rows, restored.columns):
            raise ValueError(
                f"restored: {restored.rows} x {restored.columns} cells of {restored.cell_mm:g} mm do not fit it"
            )
        self.pieces = self.cells.taxel.size
        self._shapes = {"raw": self.array.frame_shape, "restored": self.cells.shape}
        self._shapes |= {"shear": (2, *self.array.frame_shape)} if state.shear else {}
        self.hub, self.timings = Hub(), Timings()
        self.history = History(*history, self._shapes["raw"], self._shapes["restored"], state.shear)
        self._image_at: float | None = None  # s, monotonic: the newest image
        self._transit = 0.0, 0.0  # s, Unix: when that was made, by the reader's clock, and came, by ours
        self._detail: tuple[bytes | None, dict[str, Any]] = None, {}  # as it came, and as an image has it
        self._tracking = ContactSearch(self.name, self.hub, self.array, self.cells)
        self._tracking.start()

    @property
    def plan(self) -> RemotePlan:
        """How it is made."""
        values, robot = self.reported, self.name.partition("/")[0]
        return RemotePlan(self.name, f"{robot}/{values.bus}", values.codec, values.shear, values.unit)

    @property
    def method(self) -> str:
        """Name of the method that is set."""
        return self.reported.method

    @property
    def clock(self) -> str | None:
        """That gives the frames' times."""
        return self.reported.clock

    @property
    def references(self) -> list[float | None] | None:
        """Counts of pads that feel no pressure."""
        return self.reported.references

    @property
    def areas_mm2(self) -> tuple[float, ...] | None:
        """Areas of the taxels, without a grid."""
        return self.geometry.areas_mm2

    def need_traction(self) -> None:
        """NoShearError: no reader sends what it restores of shear."""
        raise NoShearError(f"sensor {self.name!r}: shear that a reader restores is not sent on: ask its service")

    def need_shear(self) -> None:
        """NoShearError where its skin feels none."""
        if not self.reported.shear:
            raise NoShearError(f"sensor {self.name!r}: its codec {self.plan.codec_name} carries no shear")

    def contacts(self) -> tuple[SensorImage | None, tuple[DetectedContact, ...]]:
        """The newest image and the contacts in it, found here; any thread."""
        return self._tracking.contacts()

    def deviation(self, image: SensorImage) -> NDArray[np.float32]:
        """Standard deviation of every cell of the newest restored image, by its reader."""
        answer = self._request(Request("GET", "frames/deviation", "format=npy"))
        if answer.status != 200:
            raise ReaderError(f"sensor {image.sensor!r}: its reader has no deviation: HTTP {answer.status}")
        try:
            return messages.deviation(answer.body, self._shapes["restored"])
        except ValueError as error:
            raise ReaderAnswerError(f"sensor {image.sensor!r}: its reader answers wrongly: {error}") from None

    def note_send(self, image: SensorImage) -> None:
        """Nothing: the age of its frames when they are sent is not counted here."""

    def stop(self) -> None:
        """Stop its thread."""
        self._tracking.stop()

    def fits(self, head: Head, kind: str, size: int) -> bool:
        """Whether a message of this kind and size (bytes) can be part of a frame."""
        shape = self._shapes.get(kind)
        return shape is not None and head.kinds == len(self._shapes) and size <= HEADER.size + 5 * prod(shape)

    def take(self, parts: Mapping[str, tuple[bytes, bytes]], now: float, wall: float) -> None:
        """Publish the frame of these messages, which came at `now` (s, monotonic; `wall`: Unix).

        ValueError where it is none of this sensor.
        """
        images = {kind: messages.image(kind, message, self._shapes[kind]) for kind, (message, _) in parts.items()}
        raw, detail = images["raw"], parts["restored"][1]
        if detail != self._detail[0]:
            values = messages.read(messages.Detail, detail, messages.MAX_DETAIL_BYTES)
            warnings = tuple(each.warning() for each in values.warnings)
            self._detail = detail, values.model_dump(exclude={"warnings"}) | {"warnings": warnings}
        shear = images["shear"].values if "shear" in images else None
        image = SensorImage(
            sensor=self.name, sequence=raw.sequence, time=raw.timestamp, raw=raw.values,
            restored=images["restored"].values, flags=raw.flags.reshape(self._shapes["raw"]),
            iterations=raw.iterations, microseconds=raw.microseconds, noise=raw.noise, noise_gain=raw.noise_gain,
            resolution_mm=raw.resolution_mm, shear=shear, arrived=now, unit=raw.unit, **self._detail[1],
        )  # fmt: skip
        self._image_at, self._transit = now, (raw.made_at, wall)
        self.hub.publish(image)
        self.history.keep(image)

    def status(self) -> Status:
        """Health at this moment."""
        now, values = time.monotonic(), self.reported
        state, detail = self._judge(now)
        live = state == "live"
        lost = {each.name: values.loss.get(each.name, 0) for each in fields(Loss)}
        return Status(
            state=state,
            age_s=self._age(now),
            rate_hz=values.rate_hz if live else 0.0,
            detail=detail,
            loss=Loss(**lost | {"undelivered": self.line.lost}),
            jitter_s=values.jitter_s if live else None,
            skew_s=values.skew_s,
            errors=values.error_kinds,
            tared_at=values.tared_at,
        )

    @property
    def state(self) -> State:
        """State of `status`, at less cost."""
        return self._judge(time.monotonic())[0]

    def _age(self, now: float) -> float | None:
        """Of the newest frame, s; None where there is none, or where the two clocks were not compared."""
        offset, (made, came) = self.line.offset.offset_s, self._transit
        if self._image_at is None or offset is None:
            return None
        return max(0.0, came + offset - made) + now - self._image_at

    def _judge(self, now: float) -> tuple[State, str]:
        """State and detail: the first of these that holds."""
        if self.line.down is not None:
            return "down", self.line.down
        if (silent := now - self.line.heard_at) > SILENT_AFTER_S:
            return "stale", f"no message from its reader for {silent:.1f} s"
        if now - self.line.refused_at < REFUSED_S:
            return "stale", f"a message of its reader is refused: {self.line.refused}"
        state, detail = self.reported.state, self.reported.detail
        if state == "live":
            if self._image_at is None:
                return "silent", "no image has come from its reader yet"
            if (age := now - self._image_at) > self.reported.stale_after_s:
                return "stale", f"its reader has frames, none came here for {age:.1f} s"
            if self.line.offset.offset_s is None:
                detail = "age unknown: its reader's clock is not compared yet"
        return state, detail
