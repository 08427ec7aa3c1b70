"""A session of Zenoh's network, the keys of a sensor on it, and the head of every message."""

import importlib.util
import json
from pathlib import Path
from struct import Struct
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from tactiled.config import Zenoh
from tactiled.errors import ConfigError, TactileError

if TYPE_CHECKING:
    import zenoh

LEASE_S = 5.0  # without a sign of life a link is given up: half of Zenoh's default, to tell a partition sooner
HEARTBEAT_S = 1.0  # from one state message of a sensor to the next
LOST_AFTER_S = 3.5  # of silence before a token ends, from which the way was cut: a process that dies ends its
# token at once, at most HEARTBEAT_S after its last message; a cut takes LEASE_S
QUEUE_BATCHES = 4  # that wait for a link, a frame each: what waits longer is old
MAX_WAIT_S = 0.02  # that a publisher waits for a link before Zenoh drops: newer images replace older ones
REQUEST_S = 10.0  # until a reader must have answered
MAX_MESSAGE_BYTES = 16 << 20  # that a peer may have us put together; a longer one is dropped, its link stays
HEAD = Struct("<8sQBx")  # of an attachment: session, number, kinds of the frame


class Head(NamedTuple):
    """Which message of which publisher it is."""

    session: str  # random, of one publisher of one sensor; 16 hex digits
    number: int  # 1, 2, 3, ... of the sensor's frames in that session, dropped ones included
    kinds: int  # messages that the frame has: raw, restored and, of a 3-axis skin, shear

    def pack(self, detail: bytes = b"") -> bytes:
        """As the attachment of a message, with what follows it."""
        return HEAD.pack(bytes.fromhex(self.session), self.number, self.kinds) + detail


def unpack(attachment: bytes) -> tuple[Head, bytes]:
    """The head of a message, and what follows it; ValueError where it is none."""
    if len(attachment) < HEAD.size:
        raise ValueError(f"an attachment of {len(attachment)} bytes: expected {HEAD.size} or more")
    session, number, kinds = HEAD.unpack_from(attachment)
    return Head(session.hex(), number, kinds), attachment[HEAD.size :]


def need(setting: str, ros: bool = False) -> None:
    """ConfigError where the package is not installed, or with `ros` the one for ROS 2."""
    if importlib.util.find_spec("zenoh") is None:
        raise ConfigError(f'{setting}: eclipse-zenoh is not installed: pip install "tactiled[zenoh]"')
    if ros and importlib.util.find_spec("rosbags") is None:
        raise ConfigError(f'{setting}.ros_domain: rosbags is not installed: pip install "tactiled[ros]"')


def configuration(settings: Zenoh, users: Path) -> "zenoh.Config":
    """Zenoh's own configuration: nothing is searched for by multicast, a lost link is tried again for ever.

    `users` is a file for those that a listening side lets in: its own user.
    """
    import zenoh

    certificate, key, root = settings.tls_certificate, settings.tls_key, settings.tls_root_certificate
    is_client = settings.mode == "client"
    values = {
        "mode": settings.mode,
        "connect/endpoints": settings.connect,
        "connect/timeout_ms": 0 if is_client else -1,  # a client that waits in `open` could not be stopped
        "connect/exit_on_failure": is_client,
        "listen/endpoints": settings.listen,
        "scouting/multicast/enabled": False,
        "transport/link/tx/lease": round(1000 * LEASE_S),
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "transport/link/tx/queue/size/data": QUEUE_BATCHES,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": round(1e6 * MAX_WAIT_S),
        "transport/link/tls/root_ca_certificate": root,
        "transport/link/tls/listen_certificate": certificate,
        "transport/link/tls/listen_private_key": key,
        "transport/link/tls/connect_certificate": certificate,
        "transport/link/tls/connect_private_key": key,
        "transport/link/tls/enable_mtls": bool(certificate and root),
        "transport/auth/usrpwd/user": settings.user,
    }
    if settings.password:
        password = settings.password.get_secret_value()
        users.write_text(f"{settings.user}:{password}\n")
        values["transport/auth/usrpwd/password"] = password
        values["transport/auth/usrpwd/dictionary_file"] = str(users) if settings.listen else None
    made = zenoh.Config()
    for name, value in values.items():
        if value is not None:
            made.insert_json5(name, json.dumps(value, default=str))
    return made


def open_session(settings: Zenoh) -> "zenoh.Session":
    """Join the network; TactileError where an endpoint cannot be had now."""
    import zenoh

    try:
        with TemporaryDirectory() as folder:  # only ours, by its mode; Zenoh reads the file when it opens
            return zenoh.open(configuration(settings, Path(folder) / "users"))
    except zenoh.ZError as error:
        ends = ", ".join((*settings.connect, *settings.listen))
        raise TactileError(f"zenoh, {ends}: {str(error).split(' at /')[0].strip()}") from error


def connected(session: "zenoh.Session") -> bool:
    """Whether a router or a peer is there."""
    return bool(session.info.routers_zid() or session.info.peers_zid())


class Request(NamedTuple):
    """A request of the REST API on its way to a reader."""

    method: str
    path: str  # from /api/v1 on, of a sensor by its own name
    query: str = ""
    headers: dict[str, str] = {}  # noqa: RUF012, never changed
    body: bytes = b""
    refusal: str | None = None  # why it may change nothing, "": it may; None: it has not come by a server


class Answer(NamedTuple):
    """What the reader's REST API answers."""

    status: int
    headers: dict[str, str]
    body: bytes
