"""One sensor's images as messages of ROS 2.

Lengths are in m, in a frame of reference with the sensor's name: x along a row, y down a column, z into the skin.
Only messages of `tactiled_msgs` have mm and kPa, and their fields say so.
"""

from collections.abc import Iterator
from dataclasses import asdict
from math import cos, inf, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos

from tactiled.build import SensorPlan
from tactiled.contacts.detection import Contact
from tactiled.frames import Image
from tactiled.geometry import tiling
from tactiled.interop.ros_types import LATCHED, RELIABLE, SENSOR_DATA, Types
from tactiled.units import FORCE_SCALES, FORCE_UNITS, PRESSURE

M_PER_MM = 1e-3
DIAGNOSTICS_EVERY_S = 1.0  # at least, as ROS's diagnostic_updater by default
DISC_SIGMAS = 2.0  # radius of a contact's disc, in standard deviations of its pressure
DISC_M, LABEL_M = 5e-5, 1e-3  # height of that disc, and of its text
CYLINDER, TEXT_VIEW_FACING, DELETE_ALL = 3, 9, 3  # of visualization_msgs/Marker
OK, WARN = 0, 1  # of diagnostic_msgs/DiagnosticStatus
WHITE, GLASS = {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0}, {"r": 1.0, "g": 1.0, "b": 1.0, "a": 0.4}
CONTACT_FIELDS = "id", "x_mm", "y_mm", "force", "peak", "area_mm2", "major_mm", "minor_mm", "angle_rad"

Fields = dict[str, Any]
Message = tuple["Topic", memoryview]  # and its CDR


class Topic(NamedTuple):
    """What a topic's messages are."""

    name: str
    type: str
    qos: Qos


def nanoseconds(time_s: float) -> int:
    """A time as ROS has it."""
    return round(time_s * 1e9)


def ros_name(name: str) -> str:
    """A sensor's name as ROS 2 takes it in topics: letters, digits and `_`, no digit first."""
    plain = name.replace("-", "_")
    return f"sensor_{plain}" if plain[0].isdigit() else plain


class Topics:
    """One sensor's topics, and its images as messages of them; remembers the last diagnostics."""

    def __init__(self, plan: SensorPlan) -> None:
        self.types = Types()
        self._plan, self._name, self._unit = plan, ros_name(plan.name), plan.unit
        self._taxels = tiling(plan.array)
        self._areas = FORCE_SCALES[plan.unit] * plan.cells.areas.astype(np.float32)
        self._diagnosed: tuple[tuple[str, ...], float] = (), -inf  # codes of warnings, and when (s)

        def topic(name: str, kind: str, qos: Qos = RELIABLE) -> Topic:
            return Topic(f"/{self._name}/{name}", kind, qos)

        self._raw = topic("raw", "sensor_msgs/msg/Image", SENSOR_DATA)
        self._shear = topic("shear", "sensor_msgs/msg/Image", SENSOR_DATA)
        self._restored = topic("restored", "sensor_msgs/msg/Image")
        self._tactile = topic("tactile", "tactiled_msgs/msg/TactileArray")
        self._wrench = topic("wrench", "geometry_msgs/msg/WrenchStamped")
        self._markers = topic("markers", "visualization_msgs/msg/MarkerArray")
        self._layout = topic("layout", "tactiled_msgs/msg/TactileLayout", LATCHED)
        self._diagnostics = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE)
        self._tf = Topic("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        own = {self._shear: plan.shears, self._wrench: self._unit == PRESSURE, self._tf: plan.pose is not None}
        self.topics = [self._raw, self._restored, self._tactile, self._markers, self._layout, self._diagnostics]
        self.topics += [topic for topic, has in own.items() if has]

    def first(self, time_s: float) -> Iterator[Message]:
        """What holds for all images: the layout and, where it is configured, the place."""
        x, y = self._plan.array.positions.T
        fields = {"header": self._header(time_s), "x_mm": x, "y_mm": y, "area_mm2": self._taxels.areas}
        for name, cells in (("raw", self._taxels), ("restored", self._plan.cells)):
            fields |= {f"{name}_corner_mm": cells.corner, f"{name}_pixel_mm": cells.side}
        yield self._message(self._layout, fields)
        if pose := self._plan.pose:
            translation = {axis: M_PER_MM * mm for axis, mm in zip("xyz", pose.origin_mm, strict=True)}
            rotation = dict(zip("xyzw", pose.orientation, strict=True))
            placed = {"header": self._header(time_s, pose.frame_id), "child_frame_id": self._name}
            placed["transform"] = {"translation": translation, "rotation": rotation}
            yield self._message(self._tf, {"transforms": [placed]})

    def messages(self, image: Image, contacts: tuple[Contact, ...]) -> Iterator[Message]:
        """One image and the contacts in it."""
        header = self._header(image.time)
        stamped = {"header": header}
        yield self._message(self._raw, stamped | _pixels(self._taxels.picture(image.raw)))
        yield self._message(self._restored, stamped | _pixels(self._plan.cells.picture(image.restored)))
        if image.shear is not None:
            both = np.stack([self._taxels.picture(each) for each in image.shear], axis=-1)
            yield self._message(self._shear, stamped | _pixels(both))
        yield self._message(self._tactile, stamped | self._tactile_fields(image, contacts))
        if self._unit == PRESSURE:
            for each in contacts:
                yield self._message(self._wrench, stamped | {"wrench": _wrench(each)})
        markers: list[Fields] = [stamped | {"action": DELETE_ALL, "pose": {"orientation": {"w": 1.0}}}]
        markers += [stamped | each for contact in contacts for each in self._contact_markers(contact)]
        yield self._message(self._markers, {"markers": markers})
        codes = tuple(each.code for each in image.warnings)
        if codes != self._diagnosed[0] or image.time - self._diagnosed[1] >= DIAGNOSTICS_EVERY_S:
            self._diagnosed = codes, image.time
            yield self._message(self._diagnostics, stamped | {"status": [self._status(image)]})

    def _message(self, topic: Topic, fields: Fields) -> Message:
        return topic, self.types.cdr(topic.type, fields)

    def _header(self, time_s: float, frame_id: str | None = None) -> Fields:
        sec, nanosec = divmod(nanoseconds(time_s), 10**9)
        return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id or self._name}

    def _tactile_fields(self, image: Image, contacts: tuple[Contact, ...]) -> Fields:
        rows, columns = self._plan.array.shape or (0, 0)
        return {
            "sequence": image.sequence,
            "pressure_unit": image.unit,
            "force_unit": FORCE_UNITS[image.unit],
            "rows": rows,
            "columns": columns,
            "raw": image.raw.ravel(),
            "flags": image.flags.ravel(),
            "noise": image.noise,
            "force": float(self._areas @ image.restored.ravel()),
            "peak": float(image.restored.max(initial=0)),
            "method": image.method,
            "warnings": [each.code for each in image.warnings],
            "contacts": [{key: getattr(each, key) for key in CONTACT_FIELDS} for each in contacts],
        }

    def _contact_markers(self, contact: Contact) -> Iterator[Fields]:
        """An ellipse, and the force beside it."""
        half, across = contact.angle_rad / 2, 2 * DISC_SIGMAS * M_PER_MM
        place = {"x": M_PER_MM * contact.x_mm, "y": M_PER_MM * contact.y_mm}
        pose = {"position": place, "orientation": {"z": sin(half), "w": cos(half)}}
        scale = {"x": across * contact.major_mm, "y": across * contact.minor_mm, "z": DISC_M}
        both = {"id": contact.id, "pose": pose}
        yield both | {"ns": "contacts", "type": CYLINDER, "scale": scale, "color": GLASS}
        text = f"{contact.force:.{2 if self._unit == PRESSURE else 0}f} {FORCE_UNITS[self._unit]}"
        label = {"ns": "labels", "type": TEXT_VIEW_FACING, "scale": {"z": LABEL_M}, "color": WHITE}
        yield both | label | {"text": text}

    def _status(self, image: Image) -> Fields:
        values = {"method": image.method, "why": image.why, "noise": f"{image.noise:.4g} {image.unit}"}
        values |= {each.code: each.text for each in image.warnings}
        values |= {f"{name} so far": str(count) for name, count in asdict(image.loss).items()}
        return {
            "level": WARN if image.warnings else OK,
            "name": f"tactiled: {self._plan.name}",
            "message": "; ".join(each.text for each in image.warnings) or "no warnings",
            "hardware_id": self._plan.bus,
            "values": [{"key": key, "value": text} for key, text in values.items()],
        }


def _pixels(picture: NDArray[np.float32]) -> Fields:
    """Fields of sensor_msgs/Image of a picture (R, C) or (R, C, channels)."""
    rows, columns, *channels = picture.shape
    data = np.ascontiguousarray(picture, "<f4").view(np.uint8).ravel()
    size = {"height": rows, "width": columns, "step": len(data) // rows}
    return size | {"encoding": f"32FC{channels[0] if channels else 1}", "data": data}


def _wrench(contact: Contact) -> Fields:
    """Force of a contact on the skin, along z at its place, with its moment about the array's (0, 0)."""
    x, y, force = M_PER_MM * contact.x_mm, M_PER_MM * contact.y_mm, contact.force
    return {"force": {"z": force}, "torque": {"x": y * force, "y": -x * force}}
