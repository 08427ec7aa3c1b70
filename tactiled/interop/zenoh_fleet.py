"""The sensors of all robots on a Zenoh network, as a service has them; and the way back to their readers."""

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, get_args

from tactiled.config import Server, Zenoh
from tactiled.errors import ReaderError, UnknownSensorError
from tactiled.frames import FrameWarning
from tactiled.interop.zenoh_sensor import MAX_SKEW_S, Frame, Line, Parts, RemoteSensor
from tactiled.interop.zenoh_session import (
    HEARTBEAT_S,
    REQUEST_S,
    Answer,
    Head,
    Request,
    connected,
    open_session,
    unpack,
)  # fmt: skip
from tactiled.runtime.events import Events, Faults, Kind
from tactiled.runtime.watch import STATE_EVENTS
from tactiled.threads import join_started
from tactiled.wire import KINDS

if TYPE_CHECKING:
    import zenoh

LOOK_S = 0.1  # between two looks at the states, where nothing but images comes
LINK_S = 2 * LOOK_S  # in which the end of our own link is seen, after that of the tokens
CLOCK_S = 5.0  # between two comparisons with a reader's clock: 100 ppm of drift are 0.5 ms
MAX_QUESTIONS = 8  # to readers at a time, beside those of clients
HISTORY_SHARE = 8  # a new sensor's past images have this part of the memory that is left for them
EVENT_KINDS = frozenset(get_args(Kind))


class Fleet:
    """Every sensor that a reader publishes: what the web has of a service, by names `robot/sensor`."""

    def __init__(self, settings: Zenoh, server: Server) -> None:
        self._settings, self._server = settings, server
        self.events = Events()
        self.faults = Faults(self.events)
        self.sensors: dict[str, RemoteSensor] = {}  # replaced when one comes, never changed
        self._lines: dict[str, Line] = {}
        self._history_left = server.history_mb * 1e6  # bytes
        self._look_at = 0.0  # s, monotonic: when states are looked at next
        self._inbox: deque[Callable[[], None]] = deque()  # for the thread
        self._ready: deque[Line] = deque()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._questions = ThreadPoolExecutor(MAX_QUESTIONS, "zenoh question")
        self._session: zenoh.Session | None = None
        self._turns = 0
        self._thread = threading.Thread(target=self._run, name="zenoh", daemon=True)

    def sensor(self, name: str) -> RemoteSensor:
        """The sensor of that name; UnknownSensorError if no reader has published it."""
        try:
            return self.sensors[name]
        except KeyError as error:
            raise UnknownSensorError.among(name, self.sensors) from error

    def turns(self) -> dict[str, int | None]:
        """Turns of the thread so far; None before it has joined the network."""
        return {"zenoh": self._turns or None}

    @contextmanager
    def running(self) -> Iterator[None]:
        """Subscribe meanwhile."""
        self._thread.start()
        try:
            yield
        finally:
            self._stopping.set()
            self._wake.set()
            join_started(self._thread)
            self._questions.shutdown(cancel_futures=True)
            for sensor in self.sensors.values():
                sensor.stop()

    def request(self, name: str, request: Request) -> Answer:
        """Have a sensor's reader answer a request; ReaderError where none does."""
        line, session = self.sensor(name).line, self._session
        if line.down or session is None:
            raise ReaderError(f"sensor {name!r}: {line.down or 'not connected'}")
        resource = request.path.removeprefix("/")
        about = {"method": request.method, "query": request.query, "headers": request.headers}
        key = f"{self._base(line)}/{line.session}/rest/{resource}"
        began, timed_out = time.monotonic(), False
        replies = session.get(key, payload=request.body, attachment=json.dumps(about), timeout=REQUEST_S)
        for reply in replies:
            if reply.ok and reply.ok.attachment:
                about = json.loads(reply.ok.attachment.to_bytes())
                return Answer(about["status"], about["headers"], reply.ok.payload.to_bytes())
            timed_out = reply.err is not None and reply.err.payload.to_bytes() == b"Timeout"
            if reply.err and not timed_out:
                raise ReaderError(f"sensor {name!r}: its reader failed: {reply.err.payload.to_string()}")
        lost = f"the connection to its reader was lost after {time.monotonic() - began:.1f} s, before it answered"
        why = f"its reader did not answer within {REQUEST_S:g} s" if timed_out else lost
        unknown = "" if request.method == "GET" else ": whether it was done is unknown"
        raise ReaderError(f"sensor {name!r}: {why}{unknown}")

    def _base(self, line: Line) -> str:
        return f"{self._settings.prefix}/{line.name}"

    def _join(self) -> "zenoh.Session | None":
        sessions: list[zenoh.Session] = []
        while not sessions and not self._stopping.is_set():
            with self.faults.turn("zenoh"):
                sessions.append(open_session(self._settings))
            if not sessions:
                self._stopping.wait(HEARTBEAT_S)
        return sessions[0] if sessions else None

    def _run(self) -> None:
        session = self._session = self._join()
        if session is None:
            return
        try:
            self._subscribe(session)
            while not self._stopping.is_set():
                self._wake.wait(LOOK_S)
                self._wake.clear()
                with self.faults.turn("zenoh"):
                    self._work(time.monotonic())
                self._turns += 1
        finally:
            session.close()  # type: ignore[no-untyped-call]

    def _subscribe(self, session: "zenoh.Session") -> None:
        prefix = self._settings.prefix
        for kind in KINDS:
            session.declare_subscriber(f"{prefix}/*/*/{kind}", partial(self._take_image, kind))
        session.declare_subscriber(f"{prefix}/*/*/state", self._take_state)
        session.declare_subscriber(f"{prefix}/*/events", self._take_event)
        session.liveliness().declare_subscriber(f"{prefix}/*/*/alive/*", self._take_token, history=True)

    def _name(self, sample: "zenoh.Sample") -> str:
        """Robot and sensor of a message."""
        return "/".join(str(sample.key_expr).removeprefix(f"{self._settings.prefix}/").split("/", 2)[:2])

    def _accept(self, sample: "zenoh.Sample") -> tuple[Line, Head, bytes] | None:
        """The line of a message, if it is of the session that counts."""
        line = self._lines.get(self._name(sample))
        if line is None or sample.attachment is None:
            return None
        head, detail = unpack(sample.attachment.to_bytes())
        if head.session != line.session:
            return None
        line.heard_at = time.monotonic()
        return line, head, detail

    def _take_image(self, kind: str, sample: "zenoh.Sample") -> None:
        with suppress(ValueError):  # not one of ours
            message = self._accept(sample)
            if message and message[0].parts.add(message[1], kind, sample.payload.to_bytes(), message[2]):
                self._ready.append(message[0])
                self._wake.set()

    def _take_state(self, sample: "zenoh.Sample") -> None:
        with suppress(ValueError):
            message = self._accept(sample)
            if message:
                state = json.loads(sample.payload.to_bytes())
                self._later(partial(self._set_state, message[0], state))

    def _take_token(self, sample: "zenoh.Sample") -> None:
        import zenoh

        session = str(sample.key_expr).rpartition("/")[2]
        came = sample.kind == zenoh.SampleKind.PUT
        self._later(partial(self._set_token, self._name(sample), session, came))

    def _take_event(self, sample: "zenoh.Sample") -> None:
        with suppress(ValueError):
            event = json.loads(sample.payload.to_bytes())
            robot = str(sample.key_expr).split("/")[-2]
            self._later(partial(self._add_event, robot, event))

    def _later(self, work: Callable[[], None]) -> None:
        self._inbox.append(work)
        self._wake.set()

    def _add_event(self, robot: str, event: Mapping[str, Any]) -> None:
        if event["kind"] in EVENT_KINDS:
            sensor, bus = (event[each] and f"{robot}/{event[each]}" for each in ("sensor", "bus"))
            warning = FrameWarning(**event["warning"]) if event["warning"] else None
            self.events.add(event["kind"], event["text"], sensor, bus, warning)

    def _set_token(self, name: str, session: str, came: bool) -> None:
        """A publisher came or went."""
        line = self._lines.setdefault(name, Line(name))
        if came:
            changed, others = line.appear(session), [each for each in line.sessions if each != session]
            if others:
                text = f"sessions {others[0]} and {session} both publish it: only the first is shown"
                self.events.add("publisher_conflict", text, name)
        else:
            changed = line.vanish(session, time.monotonic())
        if changed:
            line.due, line.waiting = 0.0, None
        if came:
            line.heard_at = time.monotonic()

    def _set_state(self, line: Line, state: dict[str, Any]) -> None:
        line.close(state["closing"])
        if sensor := self.sensors.get(line.name):
            sensor.state_fields = state

    def _work(self, now: float) -> None:
        """Show the images that came; look at states after other messages, and now and then: it costs as much."""
        looks = bool(self._inbox) or now >= self._look_at
        while self._inbox:
            self._inbox.popleft()()
        while self._ready:
            line = self._ready.popleft()
            if (frame := line.parts.pop()) is not None:
                self._show(line, frame)
        if not looks:
            return
        self._look_at = now + LOOK_S
        session, peers = self._session, self._settings.connect  # without any, readers alone make a connection
        linked = session is not None and (not peers or connected(session))
        for line in self._lines.values():
            line.look_at_link(linked)
            if line.down is None and now >= line.due:
                line.due = now + CLOCK_S
                ask = self._compare_clock if line.described == line.session else self._describe
                self._questions.submit(ask, line, str(line.session))
        self._look()

    def _show(self, line: Line, frame: Frame) -> None:
        head, messages = frame
        if line.described != head.session:
            line.waiting = frame
            return
        with self.faults.turn(f"images of {line.name}"):
            self.sensors[line.name].take(messages, time.monotonic(), time.time())

    def _describe(self, line: Line, session: str) -> None:
        """Ask a new publisher for its sensor's state, geometry and newest frame, on a thread of `questions`."""
        with self.faults.turn(f"description of {line.name}"):
            state = next(self._get(line, "state", session), None)
            geometry = self._ask(line, f"{session}/rest/geometry")
            if state is None or geometry is None:
                line.due = time.monotonic() + HEARTBEAT_S
                return
            parts = Parts()
            for kind in KINDS:
                for head, message, detail in self._get(line, kind, session):
                    parts.add(head, kind, message, detail)
            self._compare_clock(line, session)
            description = json.loads(state[1]), json.loads(geometry)
            self._later(partial(self._set_description, line, session, *description, parts.pop()))

    def _get(self, line: Line, kind: str, session: str) -> Iterator[tuple[Head, bytes, bytes]]:
        """The newest message of a kind, of a publisher, with its head and detail."""
        assert self._session is not None
        replies = self._session.get(f"{self._base(line)}/{kind}", timeout=REQUEST_S)
        for sample in (each.ok for each in replies if each.ok):
            if sample.attachment:
                head, detail = unpack(sample.attachment.to_bytes())
                if head.session == session:
                    yield head, sample.payload.to_bytes(), detail

    def _ask(self, line: Line, resource: str) -> bytes | None:
        assert self._session is not None
        replies = self._session.get(f"{self._base(line)}/{resource}", timeout=REQUEST_S)
        return next((each.ok.payload.to_bytes() for each in replies if each.ok), None)

    def _compare_clock(self, line: Line, session: str) -> None:
        start, began = time.time(), time.monotonic()
        answer = self._ask(line, f"{session}/clock")
        if answer is not None and session == line.session:
            line.offset.add(start, float(answer), start + time.monotonic() - began)

    def _set_description(
        self, line: Line, session: str, state: dict[str, Any], geometry: dict[str, Any], newest: Frame | None
    ) -> None:
        """Take what a publisher has answered: the same sensor goes on where its geometry is the same."""
        if session != line.session:
            return
        name, sensor = line.name, self.sensors.get(line.name)
        if sensor is None or sensor.geometry != geometry or sensor.state_fields["shear"] != state["shear"]:
            if sensor is None:
                self._history_left -= (share := self._history_left / HISTORY_SHARE)
                line.history_bytes = int(share)
            history = self._server.history_s, line.history_bytes
            made = RemoteSensor(line, state, geometry, history, partial(self.request, name))
            self.sensors = self.sensors | {name: made}
            if sensor:
                sensor.stop()
        self.sensors[name].state_fields = state
        line.described, frame, line.waiting = session, line.waiting or newest, None
        if frame is not None and frame[0].session == session:
            self._show(line, frame)

    def _look(self) -> None:
        """Add an event for every change of a state, and for a clock that is wrong."""
        for name, sensor in self.sensors.items():
            line, status = sensor.line, sensor.status()
            if time.monotonic() - line.down_at < LINK_S:
                continue
            if line.state != status.state:
                self.events.add(STATE_EVENTS[status.state], status.detail or "frames come", name)
            offset = line.offset
            skewed = offset.offset_s is not None and abs(offset.offset_s) - offset.error_s > MAX_SKEW_S
            if skewed and not line.clock_skewed:
                self.events.add("clock_skewed", f"its reader's clock is {offset}", name)
            line.state, line.clock_skewed = status.state, skewed
        self.faults.clear()
