"""Images and messages in Foxglove's schemas; with `interop.foxglove` all that knows its SDK, which is an extra.

Images in rows and columns are foxglove.Grid, taxels that are no grid foxglove.PointCloud, true to scale in m: x
along a row, y down a column, in the array's own frame of reference, which has the sensor's name.
"""

import base64
import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.contacts.detection import OUTLINE_SIGMAS, DetectedContact
from tactiled.contacts.regions import Measures, RegionMeter
from tactiled.errors import ConfigError
from tactiled.frames import Message, SensorImage
from tactiled.units import COUNTS, FORCE_UNITS, M_PER_MM, Unit, force_text, nanoseconds

try:
    from foxglove import messages
except ImportError:
    messages = None  # type: ignore[assignment]

LABEL_MM, DISC_MM = 1.0, 0.05  # height of a contact's text, and of its disc
INTEGER, NUMBER, STRING, BOOLEAN, OBJECT = (
    {"type": each} for each in ("integer", "number", "string", "boolean", "object")
)  # in JSON Schema
COVER = {"thickness_mm": NUMBER, "direction": STRING, "interval_mm": {"type": "array", "items": NUMBER}}
WARNING = OBJECT | {"properties": {"code": STRING, "taxels": INTEGER, **COVER, "text": STRING}}
BUS = {"id": INTEGER, "extended": BOOLEAN, "fd": BOOLEAN, "data": STRING | {"contentEncoding": "base64"}}
STATUS = {
    "sequence": INTEGER, "method": STRING, "why": STRING, "iterations": INTEGER, "noise": NUMBER,
    "noise_gain": NUMBER, "resolution_mm": NUMBER, "force": NUMBER, "peak": NUMBER, "unit": STRING,
    "force_unit": STRING, "loss": OBJECT, "warnings": {"type": "array", "items": WARNING}, "calibration": STRING,
}  # fmt: skip
STATE = {
    "state": STRING, "detail": STRING, "age_s": NUMBER, "rate_hz": NUMBER, "method": STRING, "loss": OBJECT
}  # fmt: skip


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


def _timestamp(seconds: float) -> Any:
    sec, nsec = divmod(nanoseconds(seconds), 10**9)
    return messages.Timestamp(sec=sec, nsec=nsec)


def _pose(x_mm: float, y_mm: float, angle_rad: float = 0.0) -> Any:
    """At a place, turned by an angle from x to y."""
    return messages.Pose(
        position=messages.Vector3(x=M_PER_MM * x_mm, y=M_PER_MM * y_mm, z=0),
        orientation=messages.Quaternion(x=0, y=0, z=float(np.sin(angle_rad / 2)), w=float(np.cos(angle_rad / 2))),
    )


def _json_topic(name: str, title: str, properties: Mapping[str, object]) -> Topic:
    schema = {"title": title, "type": "object", "properties": properties}
    return Topic(name, "json", title, "jsonschema", json.dumps(schema).encode())


def _protobuf_topic(name: str, kind: Any) -> Topic:
    schema = kind.get_schema()
    return Topic(name, "protobuf", schema.name, schema.encoding, schema.data)


class _Surface:
    """Images of one shape; `fields` are their values' names and numpy types."""

    def __init__(
        self,
        name: str,
        shape: tuple[int, ...],
        positions: NDArray[np.float64],
        cell_mm: float,
        *fields: tuple[str, str],
    ) -> None:
        self._frame_id, self._columns, self._side = name.split("/")[1], shape[-1], M_PER_MM * cell_mm
        self._grid = len(shape) == 2
        place = () if self._grid else (("x", "<f4"), ("y", "<f4"), ("z", "<f4"))
        self._data = np.zeros(shape, [*place, *fields])
        if self._grid:
            self._pose = _pose(*(positions[0] - cell_mm / 2).tolist())
        else:
            self._pose = _pose(0, 0)
            self._data["x"], self._data["y"] = M_PER_MM * positions.T
        numbers = messages.PackedElementFieldNumericType
        self._fields = [
            messages.PackedElementField(
                name=each, offset=offset, type=numbers.Uint8 if form == np.uint8 else numbers.Float32
            )
            for each, (form, offset, *_) in (self._data.dtype.fields or {}).items()
        ]
        self.topic = _protobuf_topic(name, messages.Grid if self._grid else messages.PointCloud)

    def message(self, time: float, **values: NDArray[np.float32] | NDArray[np.uint8]) -> bytes:
        """One image of a time (s), its values by field."""
        for name, each in values.items():
            self._data[name] = each
        stride = self._data.itemsize
        content: dict[str, Any] = {
            "timestamp": _timestamp(time),
            "frame_id": self._frame_id,
            "pose": self._pose,
            "fields": self._fields,
            "data": self._data.tobytes(),
        }
        if not self._grid:
            return messages.PointCloud(**content, point_stride=stride).encode()
        size = messages.Vector2(x=self._side, y=self._side)
        rows: dict[str, Any] = {"row_stride": self._columns * stride, "cell_stride": stride}
        return messages.Grid(**content, **rows, column_count=self._columns, cell_size=size).encode()


class Topics:
    """One sensor's topics: /NAME/raw, /NAME/restored, /NAME/status and, where its skin feels it, /NAME/shear.

    The last is /NAME/traction, shear where it is restored.
    """

    def __init__(self, plan: SensorPlan, unit: Unit) -> None:
        name, array, cells = plan.name, plan.array, plan.cells
        taxels = array.frame_shape, array.positions, array.pitch
        self.unit = unit  # of pressure, which fields and keys name
        self._pressure = "pressure_counts" if self.unit == COUNTS else "pressure_kpa"
        pressure = self._pressure, "<f4"
        self._raw = _Surface(f"/{name}/raw", *taxels, pressure, ("flags", "u1"))
        self._restored = _Surface(f"/{name}/restored", cells.shape, cells.positions, cells.side, pressure)
        shear = ("shear_x_counts", "<f4"), ("shear_y_counts", "<f4")
        self._shear = _Surface(f"/{name}/shear", *taxels, *shear) if plan.shears else None
        drawn, load = (cells.shape, cells.positions, cells.side), (("shear_x_kpa", "<f4"), ("shear_y_kpa", "<f4"))
        self._traction = _Surface(f"/{name}/traction", *drawn, *load) if plan.restores_shear else None
        self._total = RegionMeter(None, cells)
        status = _json_topic(f"/{name}/status", "tactiled status", STATUS)
        self.topics = [self._raw.topic, self._restored.topic, status]
        self.topics += [each.topic for each in (self._shear, self._traction) if each]

    def messages(self, image: SensorImage) -> list[bytes]:
        """One image, which is in `unit`, with all that is known of it: a message for each of the topics.

        The last one, of traction, has none before a tare.
        """
        total = self._total(image)
        status = {key: getattr(image, key) for key in STATUS if hasattr(image, key)} | {
            **{key: value for key, value in total._asdict().items() if key in STATUS and value == value},
            "force_unit": FORCE_UNITS[self.unit],
            "loss": asdict(image.loss),
            "warnings": [asdict(each) for each in image.warnings],
        }
        encoded = [
            self._raw.message(image.time, **{self._pressure: image.raw}, flags=image.flags),
            self._restored.message(image.time, **{self._pressure: image.restored}),
            json.dumps(status).encode(),
        ]
        if self._shear and image.shear is not None:
            x, y = image.shear
            encoded.append(self._shear.message(image.time, shear_x_counts=x, shear_y_counts=y))
        if self._traction and image.traction is not None:
            x, y = image.traction
            encoded.append(self._traction.message(image.time, shear_x_kpa=x, shear_y_kpa=y))
        return encoded


def bus_topic(name: str) -> Topic:
    """A bus's data frames: /NAME."""
    return _json_topic(f"/{name}", "CAN frame", BUS)


def bus_message(message: Message) -> bytes:
    """One data frame."""
    data = base64.b64encode(message.data).decode()
    content = {"id": message.id, "extended": message.extended, "fd": message.fd, "data": data}
    return json.dumps(content).encode()


def state_topic(name: str) -> Topic:
    """How a sensor is doing: /NAME/state."""
    return _json_topic(f"/{name}/state", "tactiled state", STATE)


def regions_topic(name: str) -> Topic:
    """What the regions of a sensor hold: /NAME/regions."""
    measures = OBJECT | {"properties": dict.fromkeys(Measures._fields, NUMBER)}
    regions = OBJECT | {"additionalProperties": measures}
    return _json_topic(
        f"/{name}/regions", "tactiled regions", {"unit": STRING, "force_unit": STRING, "regions": regions}
    )


def regions_message(unit: Unit, regions: Mapping[str, Measures]) -> bytes:
    """What an image's regions hold, by name; a measure that is not known is left out."""
    values = {
        name: {key: value for key, value in each._asdict().items() if value == value}
        for name, each in regions.items()
    }
    return json.dumps({"unit": unit, "force_unit": FORCE_UNITS[unit], "regions": values}).encode()


def contacts_topic(name: str) -> Topic:
    """The contacts, /NAME/contacts, for the scene that the images lie in."""
    return _protobuf_topic(f"/{name}/contacts", messages.SceneUpdate)


def contacts_message(name: str, time: float, unit: Unit, contacts: tuple[DetectedContact, ...]) -> bytes:
    """The contacts of an image of a time (s), in place of those before: an ellipse each, its force beside it."""
    at = _timestamp(time)
    deletion = messages.SceneEntityDeletion(timestamp=at, type=messages.SceneEntityDeletionType.All)
    entities = [
        messages.SceneEntity(
            timestamp=at, frame_id=name, id=str(each.id), cylinders=[_ellipse(each)], texts=[_label(each, unit)]
        )
        for each in contacts
    ]
    return messages.SceneUpdate(deletions=[deletion], entities=entities).encode()


def _ellipse(contact: DetectedContact) -> Any:
    across = 2 * OUTLINE_SIGMAS * M_PER_MM
    return messages.CylinderPrimitive(
        pose=_pose(contact.x_mm, contact.y_mm, contact.angle_rad),
        size=messages.Vector3(x=across * contact.major_mm, y=across * contact.minor_mm, z=M_PER_MM * DISC_MM),
        bottom_scale=1,
        top_scale=1,
        color=messages.Color(r=1, g=1, b=1, a=0.4),
    )


def _label(contact: DetectedContact, unit: Unit) -> Any:
    return messages.TextPrimitive(
        pose=_pose(contact.x_mm, contact.y_mm),
        billboard=True,
        font_size=M_PER_MM * LABEL_MM,
        color=messages.Color(r=1, g=1, b=1, a=1),
        text=force_text(contact.force, unit),
    )
