"""Images and messages in Foxglove's schemas, and its server; the only room that knows its SDK, which is an extra.

Grids are foxglove.Grid, layouts foxglove.PointCloud, true to scale in m: x along a row, y down a column, in the
array's own frame of reference, which bears the sensor's name.
"""

import base64
import json
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.contacts.detection import Contact
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Image, Message
from tactiled.geometry import Array, Cells

try:
    import foxglove as sdk
    from foxglove import messages
except ImportError:
    sdk = messages = None  # type: ignore[assignment]

Floats = NDArray[np.float64]

MM = 1e-3  # m
BUS = {
    "title": "CAN frame",
    "type": "object",
    "properties": {
        "id": {"type": "integer", "description": "CAN id, 11 bits, or 29 where extended"},
        "extended": {"type": "boolean"},
        "fd": {"type": "boolean", "description": "CAN FD"},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
}
WARNING = {
    "type": "object",
    "properties": {
        "code": {"type": "string", "description": "for programs: it does not change"},
        "taxels": {"type": ["integer", "null"], "description": "how many it is about, where that applies"},
        "text": {"type": "string", "description": "for people: it may change"},
    },
}
STATUS = {
    "title": "tactiled status",
    "type": "object",
    "properties": {
        "sequence": {"type": "integer", "description": "counts up without wrapping, lost frames included"},
        "method": {"type": "string"},
        "why": {"type": "string"},
        "iterations": {"type": "integer"},
        "noise_kpa": {"type": "number", "description": "standard deviation of one raw taxel"},
        "noise_gain": {"type": "number", "description": "restored noise over raw noise"},
        "resolution_mm": {"type": "number", "description": "finest half-period above the noise"},
        "force_n": {"type": "number", "description": "whole force of the restored image"},
        "peak_kpa": {"type": "number", "description": "highest pressure of the restored image"},
        "loss": {"type": "object", "description": "counts so far by kind"},
        "warnings": {"type": "array", "items": WARNING},
    },
}
STATE = {
    "title": "tactiled state",
    "type": "object",
    "properties": {
        "state": {
            "type": "string",
            "description": "live; stale: no new frame; silent: none yet; down: the bus is gone",
        },
        "detail": {"type": "string", "description": "one line on the state"},
        "age_s": {"type": "number", "description": "since the last frame came in; left out before the first"},
        "rate_hz": {"type": "number", "description": "frames a second"},
        "method": {"type": "string", "description": "asked for"},
        "loss": {"type": "object", "description": "counts so far by kind"},
    },
}
PRESSURE, FLAGS = ("pressure_kpa", "<f4"), ("flags", "u1")  # fields of a cell
SHEAR = ("shear_x_counts", "<f4"), ("shear_y_counts", "<f4")
BACKLOG = 32  # messages that wait for one client of the server; the oldest is dropped
LABEL_MM, DISC_MM, SPREADS = (
    1.0,
    0.05,
    2.0,
)  # of a contact: height of its text, of its disc; radius, std deviations


class Topic(NamedTuple):
    """What a topic's messages are."""

    name: str
    encoding: str  # of its messages: protobuf, json
    schema: str
    schema_encoding: str
    schema_data: bytes


def need(what: str) -> None:
    """Raise ConfigError, which says what to install, where Foxglove's SDK is not there."""
    if messages is None:
        raise ConfigError(f"{what} needs Foxglove's SDK: pip install 'tactiled[foxglove]'")


def stamp(time: float) -> int:
    """Nanoseconds of a time (s)."""
    return round(time * 1e9)


def _json(name: str, schema: dict[str, Any]) -> Topic:
    return Topic(name, "json", schema["title"], "jsonschema", json.dumps(schema).encode())


class Surface:
    """Images with the fields `form` a cell; cells are at `positions` (N, 2) and, on a grid, of a `side` (mm)."""

    def __init__(
        self, name: str, shape: tuple[int, ...], positions: Floats, side: float, *form: tuple[str, str]
    ) -> None:
        self._frame, self._columns = name.split("/")[1], shape[-1]
        self._grid, self._side = len(shape) == 2, MM * side
        place = () if self._grid else (("x", "<f4"), ("y", "<f4"), ("z", "<f4"))
        self._data = np.zeros(shape, [*place, *form])
        x, y = (MM * (positions[0] - side / 2)).tolist() if self._grid else (0.0, 0.0)
        if not self._grid:
            self._data["x"], self._data["y"] = MM * positions.T
        self._pose = messages.Pose(
            position=messages.Vector3(x=x, y=y, z=0), orientation=messages.Quaternion(x=0, y=0, z=0, w=1)
        )
        self._fields = [_field(self._data.dtype, each) for each in self._data.dtype.names or ()]
        schema = (messages.Grid if self._grid else messages.PointCloud).get_schema()
        self.topic = Topic(name, "protobuf", schema.name, schema.encoding, schema.data)

    def message(self, time: float, **values: NDArray[np.float32] | NDArray[np.uint8]) -> bytes:
        """One image of a time (s), its values by field."""
        for name, each in values.items():
            self._data[name] = each
        stride, at = self._data.itemsize, stamp(time)
        told: dict[str, Any] = {
            "timestamp": messages.Timestamp(sec=at // 10**9, nsec=at % 10**9),
            "frame_id": self._frame,
            "pose": self._pose,
            "fields": self._fields,
            "data": self._data.tobytes(),
        }
        if not self._grid:
            return messages.PointCloud(**told, point_stride=stride).encode()
        side = messages.Vector2(x=self._side, y=self._side)
        rows: dict[str, Any] = {"row_stride": self._columns * stride, "cell_stride": stride}
        return messages.Grid(**told, **rows, column_count=self._columns, cell_size=side).encode()


def _field(form: np.dtype[Any], name: str) -> Any:
    kind, offset = (form.fields or {name: (form, 0)})[name][:2]
    number = messages.PackedElementFieldNumericType
    return messages.PackedElementField(
        name=name, offset=offset, type=number.Uint8 if kind == np.uint8 else number.Float32
    )


class Topics:
    """One sensor's topics: /NAME/raw, /NAME/restored, /NAME/status and, where its skin feels it, /NAME/shear."""

    def __init__(self, name: str, array: Array, cells: Cells, surface_shape: tuple[int, ...], shear: bool) -> None:
        side = array.pitch * array.frame_shape[0] / surface_shape[0]
        self._raw = Surface(f"/{name}/raw", array.frame_shape, array.positions, array.pitch, PRESSURE, FLAGS)
        self._restored = Surface(f"/{name}/restored", surface_shape, cells.positions, side, PRESSURE)
        taxels = array.frame_shape, array.positions, array.pitch
        self._shear = Surface(f"/{name}/shear", *taxels, *SHEAR) if shear else None
        self._areas = 1e-3 * cells.areas.astype(np.float32)  # kPa mm^2 are mN
        self.topics = [self._raw.topic, self._restored.topic, _json(f"/{name}/status", STATUS)]
        self.topics += [self._shear.topic] if self._shear else []

    def messages(self, image: Image) -> list[bytes]:
        """One image with all that is known of it: a message for each of the topics."""
        told = {key: getattr(image, key) for key in STATUS["properties"] if hasattr(image, key)}
        told["force_n"] = float(np.dot(self._areas, image.restored.reshape(-1)))
        told["peak_kpa"] = float(image.restored.max(initial=0))
        told["loss"], told["warnings"] = asdict(image.loss), [asdict(each) for each in image.warnings]
        made = [
            self._raw.message(image.time, pressure_kpa=image.raw, flags=image.flags),
            self._restored.message(image.time, pressure_kpa=image.restored),
            json.dumps(told).encode(),
        ]
        if self._shear and image.shear is not None:
            x, y = image.shear
            made.append(self._shear.message(image.time, shear_x_counts=x, shear_y_counts=y))
        return made


def bus_topic(name: str) -> Topic:
    """A bus's data frames: /NAME."""
    return _json(f"/{name}", BUS)


def bus_message(message: Message) -> bytes:
    """One data frame."""
    data = base64.b64encode(message.data).decode()
    told = {"id": message.id, "extended": message.extended, "fd": message.fd, "data": data}
    return json.dumps(told).encode()


def state_topic(name: str) -> Topic:
    """How a sensor is doing: /NAME/state."""
    return _json(f"/{name}/state", STATE)


def contacts_topic(name: str) -> Topic:
    """Where something touches: /NAME/contacts, for the scene that the images lie in."""
    schema = messages.SceneUpdate.get_schema()
    return Topic(f"/{name}/contacts", "protobuf", schema.name, schema.encoding, schema.data)


def contacts_message(name: str, time: float, contacts: tuple[Contact, ...]) -> bytes:
    """The contacts (mm, N) of a time (s), in place of those before: an ellipse each, its force beside it."""
    at = stamp(time)
    when = messages.Timestamp(sec=at // 10**9, nsec=at % 10**9)
    gone = messages.SceneEntityDeletion(timestamp=when, type=messages.SceneEntityDeletionType.All)
    entities = [
        messages.SceneEntity(
            timestamp=when, frame_id=name, id=str(each.id), cylinders=[_ellipse(each)], texts=[_label(each)]
        )
        for each in contacts
    ]
    return messages.SceneUpdate(deletions=[gone], entities=entities).encode()


def _pose(contact: Contact, turned: float = 0.0) -> Any:
    """At a contact's centre, turned by an angle (rad) from x to y."""
    return messages.Pose(
        position=messages.Vector3(x=MM * contact.x_mm, y=MM * contact.y_mm, z=0),
        orientation=messages.Quaternion(x=0, y=0, z=float(np.sin(turned / 2)), w=float(np.cos(turned / 2))),
    )


def _ellipse(contact: Contact) -> Any:
    across = (2 * SPREADS * MM * each for each in (contact.major_mm, contact.minor_mm))
    return messages.CylinderPrimitive(
        pose=_pose(contact, contact.angle_rad),
        size=messages.Vector3(**dict(zip("xy", across, strict=True)), z=MM * DISC_MM),
        bottom_scale=1,
        top_scale=1,
        color=messages.Color(r=1, g=1, b=1, a=0.4),
    )


def _label(contact: Contact) -> Any:
    return messages.TextPrimitive(
        pose=_pose(contact),
        billboard=True,
        font_size=MM * LABEL_MM,
        color=messages.Color(r=1, g=1, b=1, a=1),
        text=f"{contact.force_n:.2f} N",
    )


class Live:
    """A server for Foxglove's apps on a port of loopback (0: any free one)."""

    def __init__(self, port: int) -> None:
        need("server.foxglove")
        self._context = sdk.Context()
        try:
            self._server = sdk.start_server(
                name="tactiled", host="127.0.0.1", port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise TactileError(f"server.foxglove = {port}: {error}: choose another port, or 0 for any") from error
        self.port: int = self._server.port

    def channel(self, topic: Topic) -> "sdk.Channel":
        """Offer a topic; its `log` sends a message, and `has_sinks` says whether anyone listens."""
        schema = sdk.Schema(name=topic.schema, encoding=topic.schema_encoding, data=topic.schema_data)
        return sdk.Channel(topic.name, schema=schema, message_encoding=topic.encoding, context=self._context)

    def stop(self) -> None:
        """Close the port."""
        self._server.stop()
