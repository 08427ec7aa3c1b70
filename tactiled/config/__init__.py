"""The configuration file: what it may hold, and how it is read."""

from tactiled.config.load import load, parse, validated
from tactiled.config.schema import Config, Sensor, Server

__all__ = ["Config", "Sensor", "Server", "load", "parse", "validated"]
