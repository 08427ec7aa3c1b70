"""Types of ROS 2's messages and their CDR, by rosbags, which is an extra; ROS itself is not needed."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tactiled.frames import FLAG_BITS

DISTRIBUTION = Stores.ROS2_HUMBLE  # the types used here are the same in every later one up to Lyrical
FOREVER = QosTime(9223372036, 854775807)
TRIGGER_RESPONSE = "std_srvs/msg/TriggerResponse"  # of std_srvs/srv/Trigger; rosbags has names of messages alone
DEFINITIONS = {  # fields, parted by commas
    TRIGGER_RESPONSE: "bool success, string message",
    "tactiled_msgs/msg/TactileContact": """uint32 id, float32 x_mm, float32 y_mm, float32 force, float32 peak,
        float32 area_mm2, float32 major_mm, float32 minor_mm, float32 angle_rad, bool cut_off,
        float32 force_deviation""",
    "tactiled_msgs/msg/TactileArray": ",".join(f"uint8 {name}={bit}" for name, bit in FLAG_BITS.items())
    + """, std_msgs/Header header, uint64 sequence, string pressure_unit, string force_unit, uint32 rows,
        uint32 columns, float32[] raw, uint8[] flags, float32 noise, float32 force, float32 peak, string method,
        string[] warnings, tactiled_msgs/TactileContact[] contacts""",
    "tactiled_msgs/msg/TactileRegion": """string name, float32 force, float32 mean, float32 peak,
        float32 area_mm2""",
    "tactiled_msgs/msg/TactileRegions": """std_msgs/Header header, string pressure_unit, string force_unit,
        tactiled_msgs/TactileRegion[] regions""",
    "tactiled_msgs/msg/TactileLayout": """std_msgs/Header header, float32[] x_mm, float32[] y_mm,
        float32[] area_mm2, float32[2] raw_corner_mm, float32 raw_pixel_mm, float32[2] restored_corner_mm,
        float32 restored_pixel_mm""",
}


def _qos(reliability: QosReliability, durability: QosDurability, depth: int) -> Qos:
    keep, alive = QosHistory.KEEP_LAST, QosLiveliness.AUTOMATIC
    return Qos(keep, depth, reliability, durability, FOREVER, FOREVER, alive, FOREVER, False)


SENSOR_DATA = _qos(QosReliability.BEST_EFFORT, QosDurability.VOLATILE, 5)  # as rmw_qos_profile_sensor_data
RELIABLE = _qos(QosReliability.RELIABLE, QosDurability.VOLATILE, 10)  # as rmw_qos_profile_default
LATCHED = _qos(QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, 1)


class Types:
    """ROS's own message types, and `tactiled_msgs`."""

    def __init__(self) -> None:
        self.store = get_typestore(DISTRIBUTION)
        for name, text in DEFINITIONS.items():
            self.store.register(get_types_from_msg(text.replace(",", "\n"), name))

    def cdr(self, kind: str, values: Mapping[str, Any]) -> memoryview:
        """A message: values by field, nested ones by field again; what is left out is zero or empty."""
        return self.store.serialize_cdr(self._message(kind, values), kind)

    def _message(self, kind: str, values: Mapping[str, Any]) -> Any:
        fields = {name: self._field(form, values.get(name)) for name, form in self.store.fielddefs[kind][1]}
        return self.store.types[kind](**{**values, **fields})

    def _field(self, form: Any, value: Any) -> Any:
        node, detail = form
        if node == Nodetype.NAME:
            return self._message(detail, value or {})
        if node == Nodetype.BASE:
            return value if value is not None else "" if detail[0] == "string" else 0
        (node, name), length = detail
        if node == Nodetype.NAME:
            return [self._message(name, each) for each in value or ()]
        if name[0] == "string":
            return list(value or ())
        return np.zeros(length, name[0]) if value is None else np.asarray(value, name[0])
