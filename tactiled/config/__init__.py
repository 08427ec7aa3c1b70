"""The configuration file: what it may hold, and how it is read."""

from tactiled.config.load import (
    Buses,
    classic,
    faults_between_sections,
    load,
    load_as_meant,
    load_buses,
    load_served,
    parse,
    ros_name,
    tls_context,
    validated,
)
from tactiled.config.schema import Config, Sensor, Served, Server, Zenoh

__all__ = [
    "Buses", "Config", "Sensor", "Served", "Server", "Zenoh", "classic", "faults_between_sections", "load",
    "load_as_meant", "load_buses", "load_served", "parse", "ros_name", "tls_context", "validated",
]  # fmt: skip
