"""The sensors of a service on a Zenoh network: images, states, and answers of the REST API.

Of each sensor the newest image waits to be sent, no other: one that is overtaken leaves a gap in the numbers, and
so does one that the network drops. The bus and the restoration never wait for the network.
"""

import json
import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pydantic_core import from_json

from tactiled.config import Zenoh
from tactiled.errors import TactileError
from tactiled.frames import SensorImage
from tactiled.interop.zenoh.session import HEARTBEAT_S, LEASE_S, Answer, Head, Request, open_session
from tactiled.interop.zenoh.signatures import Gate, Question
from tactiled.live.events import Event
from tactiled.live.sensor import Sensor
from tactiled.threads import join_started
from tactiled.web.http.headers import SAFE_METHODS
from tactiled.wire import PRESSURES, SHEARED, Kind, pack

if TYPE_CHECKING:
    import zenoh

    from tactiled.interop.zenoh.ros import Node
    from tactiled.live.service import Service

LOG = logging.getLogger(__name__)
LOOK_S = 0.1  # how often a sensor's state is looked at when no image comes
RETRY_S = 1.0  # between two attempts to join the network
MAX_REQUESTS, MAX_WAITING = 4, 64  # answered at a time, as a fit takes seconds; open at most
MAX_CONFLICTS = 8  # other publishers that events name
MAX_ERROR = 300  # characters of an error that are sent
JSON, BYTES = "application/json", "application/octet-stream"
Describe = Callable[[Sensor], dict[str, Any]]  # a sensor's state, as of the REST API
Handle = Callable[[Request], Answer]


class ReaderPublisher:
    """Publishes what a service has, on a thread of its own; a network that is not there is tried for ever."""

    def __init__(self, service: "Service", settings: Zenoh, describe: Describe, handle: Handle) -> None:
        self._service, self._settings = service, settings
        self.describe, self.handle = describe, handle
        self.root, key = f"{settings.prefix}/{settings.robot}", settings.control_key
        self.gate = Gate(key.get_secret_value() if key else None)
        self.wake = threading.Event()
        self.requests = ThreadPoolExecutor(MAX_REQUESTS, "zenoh request")
        self.places = threading.Semaphore(MAX_WAITING)
        self._publications: dict[str, _Publication] = {}
        self._events: deque[Event] = deque(maxlen=100)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="zenoh", daemon=True)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Publish meanwhile, and at the end that this reader stops."""
        unsubscribe = self._service.events.subscribe(self._take_event)
        self._thread.start()
        try:
            yield
        finally:
            self._stopping.set()
            self.wake.set()
            join_started(self._thread)
            unsubscribe()
            self.requests.shutdown(cancel_futures=True)

    def ros_node(self, session: "zenoh.Session", sensor: Sensor) -> "Node | None":
        """A sensor's node for ROS 2; None where none is configured."""
        if self._settings.ros_domain is None:
            return None
        from tactiled.interop.zenoh.ros import Node  # an extra

        return Node(session, self._settings.ros_domain, sensor, self.handle, self.requests)

    def conflict(self, sensor: str, text: str) -> None:
        """Add the event that another publisher has a sensor's name."""
        LOG.warning("sensor %s: %s", sensor, text)
        self._service.events.add("publisher_conflict", text, sensor)

    def _take_event(self, event: Event) -> None:
        self._events.append(event)
        self.wake.set()

    def _run(self) -> None:
        session = self._open()
        if session is None:
            return
        try:
            while not self._stopping.is_set():
                self.wake.wait(LOOK_S)
                self.wake.clear()
                with self._service.faults.turn("zenoh"):
                    self._publish(session)
            for each in self._publications.values():
                each.close()
        finally:
            session.close()  # type: ignore[no-untyped-call]

    def _open(self) -> "zenoh.Session | None":
        last = ""
        while not self._stopping.is_set():
            try:
                return open_session(self._settings)
            except TactileError as error:
                if str(error) != last:
                    LOG.warning("%s: trying again", error)
                last = str(error)
            self._stopping.wait(RETRY_S)
        return None

    def _publish(self, session: "zenoh.Session") -> None:
        sensors = self._service.sensors
        for name, each in list(self._publications.items()):
            if sensors.get(name) is not each.sensor:  # the configuration was reloaded
                self._publications.pop(name).close()
        for name, sensor in sensors.items():
            if name not in self._publications:
                self._publications[name] = _Publication(self, session, sensor)
        for each in self._publications.values():
            each.send_due(time.monotonic())
        while self._events:
            event = self._events.popleft()
            if not event.kind.startswith("sensor_"):  # a server has its own: it sees more
                content = json.dumps(asdict(event)).encode()
                session.put(f"{self.root}/events", content, encoding=JSON)


class _Publication:
    """One sensor: nothing of it is published while another publisher has its name."""

    def __init__(self, publisher: ReaderPublisher, session: "zenoh.Session", sensor: Sensor) -> None:
        self.sensor, self.id = sensor, secrets.token_hex(8)
        self._publisher, self._session, self._base = publisher, session, f"{publisher.root}/{sensor.name}"
        self._kinds: tuple[Kind, ...] = SHEARED if sensor.plan.shears else PRESSURES
        self._waiting: deque[tuple[SensorImage, int]] = deque(maxlen=1)
        self._number = 0
        self._newest: dict[str, tuple[bytes, bytes]] = {}  # message and attachment, by kind
        self._detail: tuple[tuple[object, ...], bytes] = ((), b"")
        self._declared: list[Any] = []
        self._publishers: dict[str, Any] = {}
        self._ros: Node | None = None
        self._since = time.monotonic()
        self._state_at, self._look_at = -HEARTBEAT_S, 0.0
        self._state_key: tuple[object, ...] = ()
        self._conflicts: set[str] = set()  # sessions of other publishers that an event names
        if (image := sensor.hub.latest()) is not None:
            self._take(image)
        self._unsubscribe = sensor.hub.subscribe(self._take)

    def _take(self, image: SensorImage) -> None:
        """Let an image wait, on the thread that restored it."""
        self._number += 1
        self._waiting.append((image, self._number))
        self._publisher.wake.set()

    def send_due(self, now: float) -> None:
        """Send what is new at `now` (s, monotonic)."""
        if not self._publishers:
            if now >= self._look_at:
                self._look_at = now + HEARTBEAT_S
                self._claim(now)
            return
        with suppress(IndexError):
            image, number = self._waiting.popleft()
            self._send(image, number)
            if self._ros:
                self._ros.send(image)
        key = self.sensor.state, self.sensor.method
        if key != self._state_key or now - self._state_at >= HEARTBEAT_S:
            self._state_key, self._state_at = key, now
            self._send_state()

    def _claim(self, now: float) -> None:
        """Declare the sensor unless another publisher has; one that has just died keeps its token for LEASE_S."""
        import zenoh

        replies = self._session.liveliness().get(f"{self._base}/alive/*", timeout=HEARTBEAT_S)
        others = [str(each.ok.key_expr).rpartition("/")[2] for each in replies if each.ok]
        if others:
            if now - self._since > 2 * LEASE_S:
                self._conflict(others[0], "not published here")
            return
        drop = zenoh.CongestionControl.DROP
        for kind in (*self._kinds, "state"):
            self._publishers[kind] = self._session.declare_publisher(
                f"{self._base}/{kind}", encoding=JSON if kind == "state" else BYTES, congestion_control=drop,
                express=kind in (self._kinds[-1], "state"),  # with the last of a frame all of it leaves
            )  # fmt: skip
        self._declared = [
            self._session.declare_queryable(f"{self._base}/**", self._answer),
            self._session.liveliness().declare_subscriber(f"{self._base}/alive/*", self._notice),
            self._session.liveliness().declare_token(f"{self._base}/alive/{self.id}"),
            *self._publishers.values(),
        ]
        self._ros = self._publisher.ros_node(self._session, self.sensor)

    def _notice(self, sample: "zenoh.Sample") -> None:
        """Another publisher came: a partition kept the two from seeing each other."""
        import zenoh

        other = str(sample.key_expr).rpartition("/")[2]
        if sample.kind == zenoh.SampleKind.PUT and other != self.id:
            self._conflict(other, "both publish")

    def _conflict(self, other: str, outcome: str) -> None:
        if other not in self._conflicts and len(self._conflicts) < MAX_CONFLICTS:
            self._conflicts.add(other)
            text = f"another publisher (session {other}) has the name {self._base}: {outcome}: rename one"
            self._publisher.conflict(self.sensor.name, text)

    def _send(self, image: SensorImage, number: int) -> None:
        head, made_at = Head(self.id, number, len(self._kinds)), time.time()
        values = image.why, image.method, image.calibration, image.warnings
        if values != self._detail[0]:
            detail = dict(zip(("why", "method", "calibration"), values, strict=False))
            warnings = {"warnings": [asdict(each) for each in image.warnings]}
            self._detail = values, json.dumps(detail | warnings).encode()
        newest: dict[str, tuple[bytes, bytes]] = {}
        for kind in self._kinds:
            newest[kind] = pack(image, kind, made_at), head.pack(self._detail[1] if kind == "restored" else b"")
            self._publishers[kind].put(newest[kind][0], attachment=newest[kind][1])
        self._newest = newest

    def _send_state(self, closing: bool = False) -> None:
        self._publishers["state"].put(self._state(closing), attachment=self._head())

    def _head(self) -> bytes:
        return Head(self.id, self._number, len(self._kinds)).pack()

    def _state(self, closing: bool = False) -> bytes:
        """The sensor's state as of the REST API, and what a server needs besides."""
        beside = {"stale_after_s": self.sensor.plan.stale_after_s, "closing": closing}
        return json.dumps(self._publisher.describe(self.sensor) | beside).encode()

    def _answer(self, query: "zenoh.Query") -> None:
        """Answer a query, on a thread of Zenoh's; one to another publisher's session gets no answer here."""
        resource = str(query.key_expr).removeprefix(f"{self._base}/").removeprefix(f"{self.id}/")
        if resource == "clock":
            with query:
                query.reply(query.key_expr, repr(time.time()))
        elif resource == "challenge":
            with query:
                query.reply(query.key_expr, self._publisher.gate.challenge(time.monotonic()))
        elif resource.startswith("rest/") and "*" not in resource:
            if self._publisher.places.acquire(blocking=False):
                self._publisher.requests.submit(self._answer_rest, query, resource.removeprefix("rest/"))
            else:
                with query:
                    query.reply_err(f"its reader has {MAX_WAITING} requests to answer already: try again")
        else:
            with query:
                self._answer_newest(query)

    def _answer_newest(self, query: "zenoh.Query") -> None:
        import zenoh

        newest = self._newest | {"state": (self._state(), self._head())}
        for kind, (message, attachment) in newest.items():
            key = zenoh.KeyExpr(f"{self._base}/{kind}")
            if query.key_expr.intersects(key):
                encoding = JSON if kind == "state" else BYTES
                query.reply(key, message, encoding=encoding, attachment=attachment)

    def _answer_rest(self, query: "zenoh.Query", resource: str) -> None:
        path = "/config" if resource == "config" else f"/sensors/{self.sensor.name}/{resource}"
        with query:
            try:
                self._reply(query, path)
            except ValueError as error:  # a malformed query
                query.reply_err(f"{error}"[:MAX_ERROR])
            except Exception as error:
                LOG.exception("zenoh: %s failed", path)
                query.reply_err(f"{type(error).__name__}: {error}"[:MAX_ERROR])
            finally:
                self._publisher.places.release()

    def _reply(self, query: "zenoh.Query", path: str) -> None:
        """Answer a request; ValueError where it is none."""
        body, gate = query.payload.to_bytes() if query.payload else b"", self._publisher.gate
        about = from_json(query.attachment.to_bytes()) if query.attachment else {}
        if not isinstance(about, dict):
            raise ValueError(f"attachment = {about!r:.60}: give a JSON object")
        question = Question.model_validate({"query": str(query.parameters).replace(";", "&")} | about)
        request = Request(question.method, path, question.query, question.headers, body)
        changes = request.method not in SAFE_METHODS
        if changes:
            refusal = gate.refusal(str(query.key_expr), about, body, time.monotonic())
            request = request._replace(refusal=refusal)
        answer = self._publisher.handle(request)
        head: dict[str, Any] = {"status": answer.status, "headers": answer.headers}
        if changes and not request.refusal:
            head = gate.proven(about["challenge"], head, answer.body)
        encoding = answer.headers.get("content-type", BYTES)
        query.reply(query.key_expr, answer.body, encoding=encoding, attachment=json.dumps(head))

    def close(self) -> None:
        """Publish that the sensor is no longer published, and take its token back."""
        self._unsubscribe()
        if self._publishers:
            self._send_state(closing=True)
        if self._ros:
            self._ros.close()
        for each in self._declared:
            each.undeclare()
