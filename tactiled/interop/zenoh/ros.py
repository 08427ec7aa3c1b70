"""One sensor live in ROS 2: its messages on the keys of `rmw_zenoh`, whose nodes learn of it by liveliness tokens.

Nothing of ROS is needed here. A key is `domain/topic/type/hash of the type`; docs/ros2.md has the version read.
"""

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from hashlib import blake2b
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.interfaces import Qos, QosDurability, QosReliability

from tactiled.config import ros_name
from tactiled.contacts.detection import DetectedContact
from tactiled.frames import SensorImage
from tactiled.interop.zenoh.session import REQUEST_S, Answer, Request
from tactiled.live.sensor import Sensor
from tactiled.messages import ros
from tactiled.messages.ros_types import RELIABLE, TRIGGER_RESPONSE

if TYPE_CHECKING:
    import zenoh

LOG = logging.getLogger(__name__)
TRIGGER = "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
GID_BYTES = 16
MISS_HEARTBEAT_S = 0.5  # within which a subscriber learns that a transient-local message got lost
TARE_LOOK_S = 0.02  # from one look whether a tare has ended to the next
OF_CONTACTS = frozenset({"tactile", "wrench", "markers"})  # topics that need contacts
IDS = count()  # of nodes and endpoints: each is used once in a session
ACCEPTED = 202
Handle = Callable[[Request], Answer]


class Endpoint(NamedTuple):
    """A topic or a service."""

    name: str  # in ROS, with a slash in front
    type: str  # with its hash
    qos: Qos

    @property
    def latched(self) -> bool:
        """Whether it is transient local."""
        return self.qos.durability == QosDurability.TRANSIENT_LOCAL

    @property
    def token(self) -> str:
        """Its part of a liveliness token; what is rmw_zenoh's default is left out of its QoS."""
        best_effort = "2" if self.qos.reliability == QosReliability.BEST_EFFORT else ""
        latched = "1" if self.latched else ""
        return f"{self.name.replace('/', '%')}/{self.type}/{best_effort}:{latched}:,{self.qos.depth}:,:,:,,"

    def key(self, domain: int) -> str:
        """The key of its messages or requests."""
        return f"{domain}{self.name}/{self.type}"


class _Writer:
    """A publisher of one topic, which numbers its messages."""

    def __init__(self, publisher: Any, token: Any, key: str) -> None:
        self._publisher, self._token, self._number = publisher, token, 0
        self._gid = blake2b(key.encode(), digest_size=GID_BYTES).digest()

    def subscribed(self) -> bool:
        """Whether there is a subscriber; unknown, and therefore False, of a transient-local topic."""
        status = getattr(self._publisher, "matching_status", None)
        return status is not None and status.matching

    def put(self, cdr: memoryview) -> None:
        """Send a message."""
        self._number += 1
        self._publisher.put(bytes(cdr), attachment=attachment(self._number, self._gid))

    def undeclare(self) -> None:
        """Take the topic back."""
        self._token.undeclare()
        self._publisher.undeclare()


class Node:
    """The ROS node of one sensor: publishers of its topics, and the service `tare`; one thread publishes."""

    def __init__(
        self, session: "zenoh.Session", domain: int, sensor: Sensor, handle: Handle, requests: ThreadPoolExecutor
    ) -> None:
        self._session, self._domain, self._sensor = session, domain, sensor
        self._handle, self._closing, self._id = handle, threading.Event(), next(IDS)
        self._writers: dict[str, _Writer] = {}
        name = ros_name(sensor.name)
        self._name = f"%/%/{name}"  # enclave, namespace and name
        self._service = Endpoint(f"/{name}/tare", TRIGGER, RELIABLE)
        self._declared: list[Any] = [
            self._session.liveliness().declare_token(self._token(self._id, "NN")),
            self._session.liveliness().declare_token(self._token(next(IDS), "SS", self._service)),
            self._session.declare_queryable(
                self._service.key(domain), lambda query: requests.submit(self._answer, query), complete=True
            ),
        ]
        self._take_plan()

    def _take_plan(self) -> None:
        """Have the topics of the sensor as it is calibrated now."""
        self._plan = self._sensor.plan
        self._topics = ros.Topics(self._plan)
        self._published: SensorImage | None = None
        for topic in self._writers.keys() - set(self._topics.topics):
            self._writers.pop(topic).undeclare()
        for topic in self._topics.topics:
            if topic not in self._writers:
                kind, qos = ros.TOPICS[topic]
                type_ = f"{kind.replace('/msg/', '::msg::dds_::')}_/{self._topics.types.store.hash_rihs01(kind)}"
                endpoint = Endpoint(self._topics.full_name(topic), type_, qos)
                key = self._token(next(IDS), "MP", endpoint)
                token = self._session.liveliness().declare_token(key)
                self._writers[topic] = _Writer(self._publisher(endpoint), token, key)

    def _token(self, number: int, entity: str, endpoint: Endpoint | None = None) -> str:
        """Key of the liveliness token of the node (NN), a publisher (MP) or a service (SS)."""
        head = f"@ros2_lv/{self._domain}/{self._session.zid()}/{self._id}/{number}/{entity}/{self._name}"
        return f"{head}/{endpoint.token}" if endpoint else head

    def _publisher(self, endpoint: Endpoint) -> Any:
        """A publisher as rmw_zenoh declares one of that QoS."""
        import zenoh
        from zenoh import ext

        reliable = endpoint.qos.reliability == QosReliability.RELIABLE
        drop, key = zenoh.CongestionControl.DROP, endpoint.key(self._domain)
        reliability = zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT
        if not endpoint.latched:
            return self._session.declare_publisher(key, congestion_control=drop, reliability=reliability)
        misses = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=MISS_HEARTBEAT_S)
        return ext.declare_advanced_publisher(
            self._session, key, congestion_control=drop, reliability=reliability, publisher_detection=True,
            cache=ext.CacheConfig(endpoint.qos.depth), sample_miss_detection=misses,
        )  # fmt: skip

    def send(self, image: SensorImage) -> None:
        """Publish what is subscribed to of an image, or of a newer one if contacts are; nothing else is made."""
        if self._sensor.plan is not self._plan:
            self._take_plan()
        if image.unit != self._plan.unit:  # from before a calibration
            return
        if self._published is None:
            self._put(self._topics.first(image.time))
        topics = {name for name, writer in self._writers.items() if writer.subscribed()}
        contacts: tuple[DetectedContact, ...] = ()
        if topics & OF_CONTACTS:
            newest, contacts = self._sensor.contacts()
            image = newest or image
        if image is not self._published and image.unit == self._plan.unit:
            self._published = image
            series = self._sensor.regions.series if "regions" in topics else {}
            regions = {name: each.measure(image) for name, each in series.items()}
            self._put(self._topics.messages(image, contacts, regions, topics))

    def _put(self, messages: Iterator[ros.Message]) -> None:
        for topic, cdr in messages:
            self._writers[topic].put(cdr)

    def _answer(self, query: "zenoh.Query") -> None:
        """Tare, and reply with the number and GID of the request."""
        with query:
            try:
                number, gid = _request(query)
            except ValueError as error:
                query.reply_err(str(error))
                return
            try:
                success, message = self._tare()
            except Exception as error:
                LOG.exception("ROS 2: tare of %s failed", self._sensor.name)
                success, message = False, f"{type(error).__name__}: {error}"
            answer = bytes(self._topics.types.cdr(TRIGGER_RESPONSE, {"success": success, "message": message}))
            query.reply(self._service.key(self._domain), answer, attachment=attachment(number, gid))

    def _tare(self) -> tuple[bool, str]:
        """Whether a tare was done, and in words how it ended; waits for the end."""
        before = self._tares()
        answer = self._handle(Request("POST", f"/sensors/{self._sensor.name}/tare"))
        if answer.status != ACCEPTED:
            return False, json.loads(answer.body)["detail"]
        end = time.monotonic() + REQUEST_S
        while self._tares() == before and time.monotonic() < end and not self._closing.wait(TARE_LOOK_S):
            pass
        tared, refused, _ = self._tares()
        if tared > before[0]:
            return True, "tare complete"
        if refused > before[1]:
            return False, f"{self._sensor.pipeline.tares.load}: the zero is unchanged"
        return False, "the tare did not end: too few frames came"

    def _tares(self) -> tuple[int, int, int]:
        pipeline = self._sensor.pipeline
        return pipeline.tares.done, pipeline.tares.refused, pipeline.tares.lapsed

    def close(self) -> None:
        """Leave ROS 2: the tokens end."""
        self._closing.set()
        for each in (*self._declared, *self._writers.values()):
            each.undeclare()


def attachment(number: int, gid: bytes) -> "zenoh.ZBytes":
    """What rmw_zenoh has beside a message: its number, the time (ns, Unix) and the GID of its sender."""
    from zenoh import ext

    return ext.z_serialize((ext.Int64(number), ext.Int64(time.time_ns()), gid))


def _request(query: "zenoh.Query") -> tuple[int, bytes]:
    """Number and GID of a request; ValueError where its attachment is not `attachment`'s."""
    import zenoh
    from zenoh import ext

    data = query.attachment or zenoh.ZBytes(b"")
    try:
        number, _, gid = ext.z_deserialize(tuple[ext.Int64, ext.Int64, bytes], data)
    except ext.ZDeserializeError:
        gid = b""
    if len(gid) != GID_BYTES:
        raise ValueError(f"an attachment of {len(data)} bytes: give number, time and GID")
    return number, gid
