"""One sensor's images as messages of ROS 2.

Lengths are in m, in a frame of reference with the sensor's name: x along a row, y down a column, z into the skin.
Only messages of `tactiled_msgs` have mm and kPa, and their fields say so.
"""

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import asdict
from math import cos, inf, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats
from tactiled.build import SensorPlan
from tactiled.config import ros_name
from tactiled.contacts.detection import OUTLINE_SIGMAS, DetectedContact
from tactiled.contacts.regions import Measures, RegionMeter
from tactiled.frames import SensorImage
from tactiled.geometry import tiling
from tactiled.messages.ros_types import LATCHED, RELIABLE, SENSOR_DATA, Types
from tactiled.units import FORCE_UNITS, M_PER_MM, N_PER_KPA_MM2, PRESSURE, force_text, nanoseconds

DIAGNOSTICS_EVERY_S = 1.0  # at least, as ROS's diagnostic_updater by default
DISC_M, LABEL_M = 5e-5, 1e-3  # height of that disc, and of its text
CYLINDER, TEXT_VIEW_FACING, DELETE_ALL = 3, 9, 3  # of visualization_msgs/Marker
SMALLEST_MM = 0.1  # standard deviation of a contact's pressure
OK, WARN = 0, 1  # of diagnostic_msgs/DiagnosticStatus
WHITE = {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0}
TOPICS = {  # a slash in front: of all sensors
    "raw": ("sensor_msgs/msg/Image", SENSOR_DATA),
    "restored": ("sensor_msgs/msg/Image", RELIABLE),
    "shear": ("sensor_msgs/msg/Image", SENSOR_DATA),
    "traction": ("sensor_msgs/msg/Image", RELIABLE),
    "tactile": ("tactiled_msgs/msg/TactileArray", RELIABLE),
    "regions": ("tactiled_msgs/msg/TactileRegions", RELIABLE),
    "wrench": ("geometry_msgs/msg/WrenchStamped", RELIABLE),
    "markers": ("visualization_msgs/msg/MarkerArray", RELIABLE),
    "layout": ("tactiled_msgs/msg/TactileLayout", LATCHED),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", RELIABLE),
    "/tf_static": ("tf2_msgs/msg/TFMessage", LATCHED),
}

Fields = dict[str, Any]
Message = tuple[str, memoryview]  # of TOPICS, and its CDR


class Topics:
    """One sensor's topics, and its images as messages of them; remembers the last diagnostics."""

    def __init__(self, plan: SensorPlan) -> None:
        self.types, self._plan, self._name, self._taxels = Types(), plan, ros_name(plan.name), tiling(plan.array)
        self._total = RegionMeter(None, plan.cells)
        self._diagnosed: tuple[tuple[str, ...], float] = (), -inf  # codes of warnings, and when (s)
        own = {
            "shear": plan.shears,
            "traction": plan.restores_shear,
            "wrench": plan.unit == PRESSURE,
            "/tf_static": plan.pose is not None,
        }
        self.topics = [name for name in TOPICS if own.get(name, True)]

    def full_name(self, topic: str) -> str:
        """The name of one of `topics` in ROS."""
        return topic if topic[0] == "/" else f"/{self._name}/{topic}"

    def first(self, time_s: float) -> Iterator[Message]:
        """What holds for all images: the layout and, where it is configured, the place."""
        x, y = self._plan.array.positions.T
        fields = {"header": self._header(time_s), "x_mm": x, "y_mm": y, "area_mm2": self._taxels.areas}
        raw, restored = self._taxels, self._plan.cells
        fields |= {"raw_corner_mm": raw.corner, "raw_pixel_mm": raw.side}
        fields |= {"restored_corner_mm": restored.corner, "restored_pixel_mm": restored.side}
        yield self._message("layout", fields)
        if pose := self._plan.pose:
            translation = {axis: M_PER_MM * mm for axis, mm in zip("xyz", pose.origin_mm, strict=True)}
            rotation = dict(zip("xyzw", pose.orientation, strict=True))
            placed = {"header": self._header(time_s, pose.frame_id), "child_frame_id": self._name}
            placed["transform"] = {"translation": translation, "rotation": rotation}
            yield self._message("/tf_static", {"transforms": [placed]})

    def messages(
        self,
        image: SensorImage,
        contacts: tuple[DetectedContact, ...],
        regions: Mapping[str, Measures],
        selection: Container[str] = TOPICS,
    ) -> Iterator[Message]:
        """One image, its contacts and what its regions hold, by name, on the topics of `selection`."""
        stamped = {"header": self._header(image.time)}
        makers: dict[str, Callable[[], list[Fields]]] = {
            "raw": lambda: [stamped | _pixels(self._taxels.picture(image.raw))],
            "restored": lambda: [stamped | _pixels(image.restored)],
            "shear": lambda: [stamped | self._shear_pixels(each) for each in (image.shear,) if each is not None],
            "traction": lambda: [
                stamped | _pixels(np.moveaxis(each, 0, -1)) for each in (image.traction,) if each is not None
            ],
            "tactile": lambda: [stamped | self._tactile_fields(image, contacts)],
            "regions": lambda: [stamped | _region_fields(image, regions)] if regions else [],
            "wrench": lambda: [stamped | {"wrench": each} for each in self._wrenches(image, contacts)],
            "markers": lambda: [{"markers": [stamped | each for each in self._markers(contacts)]}],
            "/diagnostics": lambda: [stamped | each for each in self._diagnostics(image)],
        }
        for topic in self.topics:
            if topic in makers and topic in selection:
                for fields in makers[topic]():
                    yield self._message(topic, fields)

    def _message(self, topic: str, fields: Fields) -> Message:
        return topic, self.types.cdr(TOPICS[topic][0], fields)

    def _header(self, time_s: float, frame_id: str | None = None) -> Fields:
        sec, nanosec = divmod(nanoseconds(time_s), 10**9)
        return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id or self._name}

    def _tactile_fields(self, image: SensorImage, contacts: tuple[DetectedContact, ...]) -> Fields:
        """All that a frame's arrays and numbers are, with their units."""
        rows, columns = self._plan.array.shape or (0, 0)
        total = self._total(image)
        sums = {"force": total.force, "peak": total.peak}
        arrays = {"rows": rows, "columns": columns, "raw": image.raw.ravel(), "flags": image.flags.ravel()}
        about = {"sequence": image.sequence, "noise": image.noise, "method": image.method}
        about["warnings"] = [each.code for each in image.warnings]
        return sums | _units(image) | arrays | about | {"contacts": [asdict(each) for each in contacts]}

    def _wrenches(self, image: SensorImage, contacts: tuple[DetectedContact, ...]) -> Iterator[Fields]:
        """Force on the skin of each contact, and its moment about the array's (0, 0).

        Force along the skin, where it is restored, is of the contact in whose ellipse a cell lies deepest.
        """
        drag = np.zeros((3, len(contacts)))
        if image.traction is not None and contacts:
            cells = self._plan.cells
            owner = np.stack([_depth(each, cells.positions) for each in contacts]).argmin(axis=0)
            (x, y), newtons = M_PER_MM * cells.positions.T, cells.side**2 * N_PER_KPA_MM2
            along, down = np.nan_to_num(image.traction.reshape(2, -1)).astype(float) * newtons
            moment = x * down - y * along
            drag = np.stack([np.bincount(owner, each, len(contacts)) for each in (along, down, moment)])
        for contact, (along, down, moment) in zip(contacts, drag.T.tolist(), strict=True):
            x, y, force = M_PER_MM * contact.x_mm, M_PER_MM * contact.y_mm, contact.force
            torque = {"x": y * force, "y": -x * force, "z": moment}
            yield {"force": {"x": along, "y": down, "z": force}, "torque": torque}

    def _shear_pixels(self, shear: NDArray[np.float32]) -> Fields:
        return _pixels(np.stack([self._taxels.picture(each) for each in shear], axis=-1))

    def _markers(self, contacts: tuple[DetectedContact, ...]) -> Iterator[Fields]:
        yield {"action": DELETE_ALL, "pose": {"orientation": {"w": 1.0}}}
        for each in contacts:
            yield from self._contact_markers(each)

    def _contact_markers(self, contact: DetectedContact) -> Iterator[Fields]:
        """An ellipse, and the force beside it."""
        half, across = contact.angle_rad / 2, 2 * OUTLINE_SIGMAS * M_PER_MM
        place = {"x": M_PER_MM * contact.x_mm, "y": M_PER_MM * contact.y_mm}
        both = {"id": contact.id, "pose": {"position": place, "orientation": {"z": sin(half), "w": cos(half)}}}
        scale = {"x": across * contact.major_mm, "y": across * contact.minor_mm, "z": DISC_M}
        yield both | {"ns": "contacts", "type": CYLINDER, "scale": scale, "color": WHITE | {"a": 0.4}}
        label = {"ns": "labels", "type": TEXT_VIEW_FACING, "scale": {"z": LABEL_M}, "color": WHITE}
        yield both | label | {"text": force_text(contact.force, self._plan.unit)}

    def _diagnostics(self, image: SensorImage) -> Iterator[Fields]:
        """The status if it has changed, and every DIAGNOSTICS_EVERY_S."""
        codes = tuple(each.code for each in image.warnings)
        if codes != self._diagnosed[0] or image.time - self._diagnosed[1] >= DIAGNOSTICS_EVERY_S:
            self._diagnosed = codes, image.time
            yield {"status": [self._status(image)]}

    def _status(self, image: SensorImage) -> Fields:
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


def _units(image: SensorImage) -> Fields:
    return {"pressure_unit": image.unit, "force_unit": FORCE_UNITS[image.unit]}


def _region_fields(image: SensorImage, regions: Mapping[str, Measures]) -> Fields:
    each = [
        {"name": name, "force": now.force, "mean": now.mean, "peak": now.peak, "area_mm2": now.area}
        for name, now in regions.items()
    ]
    return _units(image) | {"regions": each}


def _pixels(picture: NDArray[np.float32]) -> Fields:
    """Fields of sensor_msgs/Image of a picture (R, C) or (R, C, channels)."""
    rows, columns, *channels = picture.shape
    data = np.ascontiguousarray(picture, "<f4").view(np.uint8).ravel()
    size = {"height": rows, "width": columns, "step": len(data) // rows}
    return size | {"encoding": f"32FC{channels[0] if channels else 1}", "data": data}


def _depth(contact: DetectedContact, places: Floats) -> Floats:
    """Distance of places (M, 2), mm, from a contact's middle, over the standard deviations of its pressure."""
    x, y = places.T - np.array([[contact.x_mm], [contact.y_mm]])
    along, across = np.cos(contact.angle_rad), np.sin(contact.angle_rad)
    major, minor = (max(each, SMALLEST_MM) for each in (contact.major_mm, contact.minor_mm))
    return np.asarray(np.hypot((along * x + across * y) / major, (along * y - across * x) / minor))
