"""TOML to a checked Config; every fault of the file at once, each with its place."""

import difflib
import functools
import re
import ssl
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import fields
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, Field, ValidationError
from pydantic_core import ErrorDetails

from tactiled import logs
from tactiled.bounds import Name, place, reason
from tactiled.bus import skins
from tactiled.bus.redact import Secret, seal, show
from tactiled.config import schema
from tactiled.config.schema import Bus, Config, Section, Served
from tactiled.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)
MAX_DEPTH = 16  # nested tables and lists; sensor.NAME.array.positions_mm[0] is at depth 4
TABLES: dict[str, type[BaseModel]] = {
    "": Config, "server": schema.Server, "zenoh": schema.Zenoh, "bus": schema.Bus, "sensor": schema.Sensor,
    "array": schema.Array, "cover": schema.Layer, "kernel": schema.Kernel, "calibration": schema.Calibration,
}  # fmt: skip
IN_SENSOR = 3  # parts of the place of a key of a sensor, sensor.NAME.KEY: keys of its tables have more
FD_ON_REQUEST = ("kvaser", "pcan", "socketcan", "vector")  # python-can's interfaces that speak CAN FD if fd = true


class Buses(Section):
    """What `tactiled sniff` and `record` read: sensors may be missing, and are not looked at."""

    server: schema.Server = schema.Server()
    zenoh: Any = None
    bus: dict[Name, Bus] = Field(min_length=1)
    sensor: Any = None


def load(path: Path) -> Config:
    """Read the file at `path`; ConfigError with one line for each fault."""
    return parse(_read(path), str(path), path.parent)


def load_as_meant(path: Path) -> tuple[Config, tuple[str, ...]] | None:
    """Read a file, its numbers past their bounds as they may have been meant, and give the places of these.

    Sensors with other faults are left out; None where there are faults elsewhere, or no sensor is left.
    """
    data = _parse(_read(path), str(path))
    context = {"folder": path.parent}
    try:
        return Config.model_validate(data, context=context), ()
    except ValidationError as error:
        faults = error.errors()
    past = [fault for fault in faults if "meant" in fault.get("ctx", {})]
    others = [fault["loc"] for fault in faults if fault not in past]
    left_out = {loc[1] for loc in others if loc[0] == "sensor" and len(loc) > 1}
    try:
        for fault in past:
            *tables, key = fault["loc"]
            table: Any = functools.reduce(_in_table, tables, data)
            table[key] = fault["ctx"]["meant"]
        data["sensor"] = {name: each for name, each in data["sensor"].items() if name not in left_out}
        return Config.model_validate(data, context=context), tuple(place(_stood_in(fault)) for fault in past)
    except (ValidationError, LookupError, TypeError, AttributeError):
        return None


def _stood_in(fault: ErrorDetails) -> tuple[int | str, ...]:
    """What is not the file's own: a value that a slip explains, else the whole table of a sensor that has it."""
    loc = fault["loc"]
    return loc if fault["ctx"]["slip"] or len(loc) <= IN_SENSOR else loc[:-1]


def _in_table(table: Any, part: int | str) -> Any:
    """A part of a table."""
    return table if _is_one_layer(table, part) else table[part]


def _is_one_layer(table: Any, part: int | str) -> bool:
    """Whether a table is the first of a list itself, as the file may have one layer."""
    return part == 0 and isinstance(table, dict)


def load_buses(path: Path) -> Buses:
    """Read how a file opens its buses; ConfigError as of `load`."""
    buses = validated(Buses, _parse(_read(path), str(path)), str(path), path.parent)
    logs.hide({name: bus.settings() for name, bus in buses.bus.items()})
    return buses


def load_served(path: Path) -> Served:
    """Read the file of `tactiled serve`; ConfigError as of `load`."""
    served = validated(Served, _parse(_read(path), str(path)), str(path), path.parent)
    logs.hide(_secrets(served))
    return served


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror}: give the path of a configuration (`tactiled init` writes one)"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text at byte {error.start}") from error


def parse(text: str, source: str = "config", folder: Path = Path()) -> Config:
    """Read a configuration from TOML text; `source` names it in the ConfigError, its paths begin in `folder`."""
    data = _parse(text, source)
    if "zenoh" in data and not {"bus", "sensor"} & data.keys():
        raise ConfigError(f"{source}: bus, sensor: missing: only `tactiled serve` needs neither")
    config = validated(Config, data, source, folder)
    if faults := list(faults_between_sections(config)):
        raise ConfigError("\n".join(f"{source}: {fault}" for fault in faults))
    logs.hide(_secrets(config))
    return config


def _parse(text: str, source: str) -> dict[str, Any]:
    try:
        data = tomllib.loads(text)
        _check_depth(data, MAX_DEPTH)
    except ValueError as error:  # no TOML, or a number of more digits than Python reads
        raise ConfigError(f"{source}: not TOML: {error}") from error
    except RecursionError as error:
        raise ConfigError(f"{source}: tables or lists are nested too deep: take some of them out") from error
    return data


def _secrets(config: Config | Served) -> dict[str, Any]:
    network = (config.zenoh.password, config.zenoh.control_key) if config.zenoh else ()
    tokens = config.server.read_token, config.server.control_token, *network
    buses = config.bus if isinstance(config, Config) else {}
    return {
        "buses": {name: bus.settings() for name, bus in buses.items()},
        "tokens": [Secret(each.get_secret_value()) for each in tokens if each],
    }


def validated(model: type[Model], data: dict[str, Any], source: str, folder: Path = Path()) -> Model:
    """A table of the file, checked; ConfigError, a line a fault, each begun by `source`."""
    try:
        return model.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        raise ConfigError("\n".join(f"{source}: {_line(fault, data)}" for fault in error.errors())) from error


def _check_depth(value: Any, depth: int) -> None:
    """RecursionError where tables or lists are nested deeper than ours, or python-can's, ever are."""
    if depth < 0:
        raise RecursionError
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_depth(each, depth - 1)


def _line(fault: ErrorDetails, data: Any) -> str:
    """One line: the place in the file's `data`, the value, what is wrong with it."""
    at, message, value = place(_written(fault["loc"], data)), reason(fault), fault["input"]
    if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{at}: {message}{_suggestion(*fault['loc'])}"
    if fault["loc"][-1:] == ("[key]",):
        return f"{place(fault['loc'][:-2])}: name {_cut(value)}: {message}"
    if not at:
        return message
    if isinstance(value, str):  # of a secret
        message = re.sub(r"\bitem(s?)\b", r"character\1", message)
    secret = at.endswith(("_token", ".password", ".control_key"))
    if secret or fault["type"] in ("missing", "value_error"):  # of a table whose values may be secrets
        return f"{at}: {message}"
    if isinstance(value, dict | list) or fault["type"] == "model_type":  # not one value of a known key
        (value,) = show([*seal({"": value}).values()])
    shown = hex(value) if isinstance(value, int) and message.startswith("give 0x") else _cut(value)
    return f"{at} = {shown}: {message}"


def _written(loc: Iterable[int | str], data: Any) -> Iterator[int | str]:
    """A place as the file has it: one layer has no number there."""
    for part in loc:
        if not _is_one_layer(data, part):
            yield part
        with suppress(LookupError, TypeError):
            data = _in_table(data, part)


def _suggestion(*loc: int | str) -> str:
    """The known key nearest to an unknown one, first one of the same stem with another unit.

    A known key in the wrong table is suggested with the right tables.
    """
    tables, key = _keys(), str(loc[-1])
    keys = set().union(*tables.values())
    if key in keys:
        right = {table for table, own in tables.items() if table and key in own} - {*loc[2:-1]}
        return f": did you mean {' or '.join(f'{table}.{key}' for table in sorted(right))}?" if right else ""
    stem = key.rsplit("_", 1)[0]
    same_stem = [other for other in keys if other.rsplit("_", 1)[0] in (stem, key)]
    near = same_stem or difflib.get_close_matches(key, keys, 1)
    return f": did you mean {min(near)}?" if near else ""


def _keys() -> dict[str, set[str]]:
    codecs = {key.name for name in skins.BUILT_IN for key in fields(skins.load(name))}  # type: ignore[arg-type]
    return {name: {*table.model_fields} for name, table in TABLES.items()} | {"codec": {"name", *codecs}}


def _cut(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def faults_between_sections(config: Config) -> Iterator[str]:
    """Faults between sections, and those that other packages know."""
    from tactiled.bus.reader import no_interface  # which imports python-can: `tactiled serve` needs none

    for name, bus in config.bus.items():
        if fault := no_interface(bus.interface):
            yield f"bus.{name}.interface = {_cut(bus.interface)}: {fault}"
    for name, sensor in config.sensor.items():
        if sensor.bus not in config.bus:
            yield f"sensor.{name}.bus = {sensor.bus!r}: no such bus: the file has {', '.join(config.bus)}"
        elif getattr(sensor.codec.settings, "fd", False) and classic(config.bus[sensor.bus]):
            yield f"sensor.{name}.codec.fd = true: bus {sensor.bus} is not CAN FD: set bus.{sensor.bus}.fd = true"
        if not sensor.cover:
            yield f"sensor.{name}.cover = []: give at least one layer, top to bottom"
    if config.zenoh and config.zenoh.ros_domain is not None:
        for one, other in combinations(config.sensor, 2):
            if ros_name(one) == ros_name(other):
                yield f"sensor.{one} and sensor.{other}: both are {ros_name(one)} in ROS 2: rename one"


def ros_name(name: str) -> str:
    """A sensor's name as ROS 2 takes it in topics: letters, digits and `_`, no digit first."""
    plain = name.replace("-", "_")
    return f"sensor_{plain}" if plain[0].isdigit() else plain


def classic(bus: Bus) -> bool:
    """Whether a bus carries no CAN FD, as far as its settings tell."""
    return bus.interface in FD_ON_REQUEST and not bus.settings().get("fd")


def tls_context(at: schema.Server) -> ssl.SSLContext | None:
    """The certificate and its key, ready for connections; None where none is configured.

    ConfigError where a file cannot be read or the two are no pair.
    """
    if at.tls_certificate is None or at.tls_key is None:
        return None
    for path in (at.tls_certificate, at.tls_key):
        try:
            path.open("rb").close()
        except OSError as error:
            why = f"{path}: {error.strerror}"
            raise ConfigError(f"{why}: give the PEM files of tls_certificate and tls_key") from error
    made = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        made.load_cert_chain(at.tls_certificate, at.tls_key)
    except OSError as error:  # also what OpenSSL has to say
        raise ConfigError(f"{at.tls_certificate}, {at.tls_key}: {error.strerror}: no PEM pair") from error
    return made
