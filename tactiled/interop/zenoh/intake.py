"""Messages of all robots, checked against one schema and each robot's budgets; no network.

A refused message makes its sensor stale and adds an event of its robot; other robots are not affected.
"""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from tactiled.config import Server
from tactiled.errors import TactileError, UnknownSensorError
from tactiled.interop.zenoh import messages
from tactiled.interop.zenoh.robots import MAX_NAMES, MAX_SESSIONS, QUIET_S, Budget, Robot
from tactiled.interop.zenoh.sensor import MAX_SKEW_S, Line, RemoteSensor
from tactiled.interop.zenoh.session import Answer, Head, Request, unpack
from tactiled.live.events import Events, Faults, Kind
from tactiled.live.watch import STATE_EVENTS

LOG = logging.getLogger(__name__)
LOOK_S = 0.1  # between two looks at the states, where nothing but images comes
LINK_S = 2 * LOOK_S  # after tokens end, until we know whether our own link has ended
FORGET_S = 600.0  # for which a sensor without a reader is listed
BUILDERS = 2  # sensors that are made at the same time, each of a different robot
# A new sensor gets an eighth of the memory that is left for past images; a robot has a quarter of all at most.
HISTORY_SHARE, ROBOT_SHARE = 8, 4
STRANGERS = 10  # events at once of robots without a sensor, all together
MAX_ROBOTS, MAX_SENSORS = 256, 512  # that are listed


class Intake:
    """Robots, their sensors and messages; messages are taken on any thread, `work` runs on one."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self.events = Events()
        self.faults = Faults(self.events)
        self.sensors: dict[str, RemoteSensor] = {}  # replaced when one comes or goes, never changed
        self.robots: dict[str, Robot] = {}
        self.lines: dict[str, Line] = {}
        self.lock = threading.RLock()  # of the three above
        self.builders = ThreadPoolExecutor(BUILDERS, "zenoh sensor")
        self.wake = threading.Event()  # there is work
        self.left_out = False  # whether there was no place for a robot
        self._strangers = Budget(1 / QUIET_S, STRANGERS)  # for events of robots without a sensor
        self._history_left = server.history_mb * 1e6  # bytes
        self._ready: dict[Line, None] = {}  # with a frame, with a state, and robots with events
        self._changed: dict[Line, None] = {}
        self._eventful: dict[Robot, None] = {}

    def sensor(self, name: str) -> RemoteSensor:
        """The sensor of that name; UnknownSensorError if no reader has published it."""
        try:
            return self.sensors[name]
        except KeyError as error:
            raise UnknownSensorError.among(name, self.sensors) from error

    def take_image(self, kind: str, resource: str, message: bytes, attachment: bytes) -> None:
        """Take an image of `robot/sensor/kind`; any thread."""
        if accepted := self._accept(resource, len(message), attachment):
            line, head, detail = accepted
            sensor = self.sensors.get(line.name)
            if sensor is None or line.described != head.session:
                return
            if not sensor.fits(head, kind, len(message)):
                self.refuse(line, f"{kind}: {len(message)} bytes, {head.kinds} kinds: not as its geometry is")
            elif line.parts.add(head, kind, message, detail):
                self._ready[line] = None
                self.wake.set()

    def take_state(self, resource: str, message: bytes, attachment: bytes) -> None:
        """Take a state of `robot/sensor/state`; any thread."""
        if (accepted := self._accept(resource, len(message), attachment)) and accepted[0].described:
            line = accepted[0]
            line.new_state = message[: messages.MAX_STATE_BYTES + 1]
            self._changed[line] = None
            self.wake.set()

    def take_event(self, resource: str, message: bytes, _: bytes) -> None:
        """Take an event of `robot/events`; any thread."""
        robot = self.robots.get(resource.partition("/")[0])
        if robot and robot.has_sensors and robot.allows(time.monotonic(), len(message)):
            robot.inbox.append(message[: messages.MAX_EVENT_BYTES + 1])
            self._eventful[robot] = None
            self.wake.set()

    def take_token(self, resource: str, came: bool) -> None:
        """A publisher of `robot/sensor/alive/session` came or went; any thread."""
        name, _, session = resource.replace("/alive/", "/", 1).rpartition("/")
        if not messages.ROBOT_AND_SENSOR.fullmatch(name) or not messages.SESSION.fullmatch(session):
            return  # not a reader of tactiled
        with self.lock:
            line = self.lines.get(name) or (self._new_line(name) if came else None)
            if line is None:
                return
            if self._appear(line, session) if came else line.vanish(session, time.monotonic()):
                line.due = 0.0
            if came:
                line.heard_at = time.monotonic()
        self.wake.set()

    def _accept(self, resource: str, size: int, attachment: bytes) -> tuple[Line, Head, bytes] | None:
        """The line of a message of so many bytes, if it is of the session that counts and may be that large."""
        line, now = self.lines.get(resource.rpartition("/")[0]), time.monotonic()
        robot = self.robots.get(line.robot) if line else None
        if line is None or robot is None:
            return None
        try:
            head, detail = unpack(attachment)
        except ValueError as error:
            self._refuse_of(robot, line.name, f"{error}")
            return None
        if head.session != line.session:
            return None
        if not robot.allows(now, size + len(attachment)):
            self.refuse(line, "more messages, or bytes, a second than a robot may send")
            return None
        line.heard_at = now
        return line, head, detail

    def _new_line(self, name: str) -> Line | None:
        """The line of a name that appears; None where its robot, or all of them, have too many."""
        own, line = name.partition("/")[0], Line(name)
        if own not in self.robots and len(self.robots) >= MAX_ROBOTS and not self._make_place():
            self.left_out = True
            return None
        robot = self.robots.setdefault(own, Robot(own))
        if len(robot.lines) >= MAX_NAMES:
            self._refuse_of(robot, None, f"more than {MAX_NAMES} sensors")
            return None
        robot.lines[name] = self.lines[name] = line
        return line

    def _make_place(self) -> bool:
        """Whether a robot that never described a sensor gives way."""
        now = time.monotonic()
        robot = next((each for each in self.robots.values() if each.is_mute(now)), None)
        for line in [*robot.lines.values()] if robot else ():
            self.forget(line)
        return robot is not None

    def _appear(self, line: Line, session: str) -> bool:
        if len(line.sessions) >= MAX_SESSIONS and session not in line.sessions:
            return False
        changed, others = line.appear(session), [each for each in line.sessions if each != session]
        robot = self.robots[line.robot]
        budget = robot.conflicts if robot.has_sensors else self._strangers  # nothing proves that the robot exists
        if others and budget.take(time.monotonic()):
            text = f"sessions {others[0]} and {session} both publish it: only the first is shown"
            self.events.add("publisher_conflict", text, line.name)
        return changed

    def _add_event(self, robot: Robot, kind: Kind, text: str, sensor: str | None) -> None:
        """An event of a robot's, within its budget."""
        if robot.events.take(time.monotonic()):
            self.events.add(kind, text, sensor)

    def refuse(self, line: Line, why: str) -> None:
        """A message is refused: its sensor is stale for a while, and nothing else."""
        line.refused, line.refused_at = why, time.monotonic()
        if robot := self.robots.get(line.robot):
            self._refuse_of(robot, line.name, why)

    def _refuse_of(self, robot: Robot, name: str | None, why: str) -> None:
        now = time.monotonic()
        if robot.refuse(now) and (robot.has_sensors or self._strangers.take(now)):
            sensor = self.sensors.get(name) if name else None
            release = sensor.reported.release if sensor else ""
            others = f" (its reader has release {release})" if release not in ("", messages.RELEASE) else ""
            self.events.add("message_refused", f"robot {robot.name}: {why}{others}", name)

    def forget(self, line: Line) -> None:
        """Forget a name that no reader has any more, and free its share of the budget."""
        robot = self.robots[line.robot]
        del self.lines[line.name], robot.lines[line.name]
        if sensor := self.sensors.get(line.name):
            self.sensors = {name: each for name, each in self.sensors.items() if each is not sensor}
            robot.pieces -= sensor.pieces
            robot.history_bytes -= line.history_bytes
            self._history_left += line.history_bytes
            self.builders.submit(sensor.stop)
            self._add_event(robot, "sensor_removed", f"its reader is gone for {FORGET_S:g} s", line.name)
        if not robot.lines:
            del self.robots[robot.name]

    def describe(
        self, line: Line, session: str, description: tuple[bytes, bytes], request: Callable[[Request], Answer]
    ) -> None:
        """Take the state and the geometry of a publisher; the same sensor goes on where the latter is the same."""
        try:
            self._build(line, session, description, request)
        except (ValueError, TactileError) as error:
            self.refuse(line, f"{error}")
        except Exception as error:  # an impossible geometry that the schema allows: no fault of this service
            LOG.exception("description of %s", line.name)
            self.refuse(line, f"geometry: {type(error).__name__}: {error!s:.100}")

    def _build(
        self, line: Line, session: str, description: tuple[bytes, bytes], request: Callable[[Request], Answer]
    ) -> None:
        state = messages.read(messages.ReportedState, description[0], messages.MAX_STATE_BYTES)
        geometry = messages.read(messages.Geometry, description[1], messages.MAX_JSON_BYTES)
        robot = self.robots.get(line.robot)
        if robot is None:  # forgotten meanwhile
            return
        before = self.sensors.get(line.name)
        sensor = before
        if before is None or (before.geometry, before.reported.shear) != (geometry, state.shear):
            pieces = robot.pieces - (before.pieces if before else 0)
            if before is None and len(self.sensors) >= MAX_SENSORS:
                raise ValueError(f"this server has {MAX_SENSORS} sensors already")
            if pieces + geometry.restored.rows * geometry.restored.columns > messages.MAX_CELLS:
                raise ValueError(f"restored: its robot's sensors have more than {messages.MAX_CELLS} cells")
            if before is None:
                self._share_history(line, robot)
            history = self._server.history_s, line.history_bytes
            sensor = RemoteSensor(line, state, geometry, history, request)
        assert sensor is not None
        with self.lock:
            if session != line.session or self.lines.get(line.name) is not line:
                stopped = sensor if sensor is not before else None
            else:
                stopped = before if sensor is not before else None
                robot.pieces += sensor.pieces - (before.pieces if before else 0)
                self.sensors = self.sensors | {line.name: sensor}
                sensor.reported, line.described = state, session
        if stopped:
            stopped.stop()

    def _share_history(self, line: Line, robot: Robot) -> None:
        """Memory for a new sensor's past images: a part of what is left, no robot more than its own part."""
        with self.lock:
            limit = self._server.history_mb * 1e6 / ROBOT_SHARE - robot.history_bytes
            line.history_bytes = int(max(0.0, min(self._history_left / HISTORY_SHARE, limit)))
            self._history_left -= line.history_bytes
            robot.history_bytes += line.history_bytes

    def work(self) -> bool:
        """Show the images that came, and read states and events; whether there were any of these."""
        looks = bool(self._changed or self._eventful)
        for line in [*self._ready]:
            del self._ready[line]
            self._show(line)
        for line in [*self._changed]:
            del self._changed[line]
            self._set_state(line)
        for robot in [*self._eventful]:
            del self._eventful[robot]
            self._read_events(robot)
        return looks

    def _show(self, line: Line) -> None:
        sensor, frame = self.sensors.get(line.name), line.parts.pop()
        if sensor is None or frame is None or line.described != frame[0].session:
            return
        try:
            with self.faults.turn(f"images of {line.name}", ValueError):
                sensor.take(frame[1], time.monotonic(), time.time())
        except ValueError as error:
            self.refuse(line, f"{error}")

    def _set_state(self, line: Line) -> None:
        data, sensor = line.new_state, self.sensors.get(line.name)
        if data is None or sensor is None:
            return
        try:
            sensor.reported = messages.read(messages.ReportedState, data, messages.MAX_STATE_BYTES)
            line.close(sensor.reported.closing)
        except ValueError as error:
            self.refuse(line, f"{error}")

    def _read_events(self, robot: Robot) -> None:
        while robot.inbox:
            try:
                event = messages.read(messages.Event, robot.inbox.popleft(), messages.MAX_EVENT_BYTES)
                if event.kind.startswith("sensor_"):  # a server has its own: it sees more
                    continue
                if not robot.events.take(time.monotonic()):
                    raise ValueError("more events than a robot may send")
            except ValueError as error:
                self._refuse_of(robot, None, f"{error}")
                continue
            sensor, bus = (each and f"{robot.name}/{each}" for each in (event.sensor, event.bus))
            text = event.text if sensor or bus else f"{robot.name}: {event.text}"
            warning = event.warning.warning() if event.warning else None
            self.events.add(event.kind, text, sensor, bus, warning)

    def look(self) -> None:
        """Add an event for every change of a state, and for a clock that is wrong."""
        for name, sensor in self.sensors.items():
            line, status = sensor.line, sensor.status()
            robot = self.robots.get(line.robot)
            if robot is None or time.monotonic() - line.down_at < LINK_S:
                continue
            if line.state != status.state:
                self._add_event(robot, STATE_EVENTS[status.state], status.detail or "receiving frames", name)
            offset = line.offset
            skewed = offset.offset_s is not None and abs(offset.offset_s) - offset.error_s > MAX_SKEW_S
            if skewed and not line.clock_skewed:
                self._add_event(robot, "clock_skewed", f"its reader's clock is {offset}", name)
            line.state, line.clock_skewed = status.state, skewed
        self.faults.clear()
