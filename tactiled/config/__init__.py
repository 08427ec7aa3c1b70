"""The configuration file: what it may say, how it is read, what the rooms make of it."""

from tactiled.config.load import load, parse
from tactiled.config.schema import Config, Sensor, Server

__all__ = ["Config", "Sensor", "Server", "load", "parse"]
