"""TOML to a checked Config; every fault of the file in one go, each named with its place."""

import difflib
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from tactiled.bus.codecs import plugins
from tactiled.bus.reader import no_interface
from tactiled.bus.redact import seal, show
from tactiled.config.codecs import BUILT_IN
from tactiled.config.schema import Bus, Config, Layer, Sensor
from tactiled.config.section import Section
from tactiled.errors import ConfigError

_SECTIONS: tuple[type[BaseModel], ...] = (Bus, *Section.__subclasses__())
DEEPEST = 16  # tables in tables; sensor.NAME.array.positions_mm[0] is the fourth
_KNOWN = {key for section in _SECTIONS for key in section.model_fields}


def load(path: Path) -> Config:
    """Read the file at `path`; ConfigError, a line a fault, if it cannot be read or says what it may not."""
    try:
        text = path.read_text("utf-8")
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror}: give the path of a configuration (`tactiled init` writes one)"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text at byte {error.start}") from error
    return parse(text, str(path), path.parent)


def parse(text: str, source: str = "config", folder: Path = Path()) -> Config:
    """Read a configuration from TOML text; `source` names it in the ConfigError, its paths begin in `folder`."""
    try:
        said = _shallow(tomllib.loads(text))
    except ValueError as error:  # no TOML, or a number of more digits than Python reads
        raise ConfigError(f"{source}: not TOML: {error}") from error
    except RecursionError as error:
        raise ConfigError(f"{source}: tables or lists are nested too deep: take some of them out") from error
    try:
        config = Config.model_validate(said, context={"folder": folder})
    except ValidationError as error:
        lines = (_line(fault) for fault in error.errors())
        raise ConfigError("\n".join(f"{source}: {line}" for line in lines)) from error
    faults = [f"{source}: {fault}" for fault in _crossed(config)]
    if faults:
        raise ConfigError("\n".join(faults))
    return config


def _shallow(said: dict[str, Any]) -> dict[str, Any]:
    """Give it back; RecursionError where it is nested deeper than any table of ours, or python-can's, is."""
    level: list[Any] = [said]
    for _ in range(DEEPEST):
        pairs = (each.values() if isinstance(each, dict) else each for each in level)
        level = [child for pair in pairs for child in pair if isinstance(child, (dict, list))]
        if not level:
            return said
    raise RecursionError


def _line(fault: ErrorDetails) -> str:
    """One line: the place, what is wrong there, the value."""
    place = _place(fault["loc"])
    if fault["type"] == "extra_forbidden":
        return f"{place}: unknown key{_meant(*fault['loc'])}"
    if fault["type"] == "missing":
        return f"{place}: missing"
    if fault["type"] == "value_error":  # of a whole table, whose values may be secrets
        return f"{place}: {fault['msg'].removeprefix('Value error, ')}"
    if place.endswith("_token"):
        return f"{place}: {fault['msg']}"
    value = fault["input"]
    if isinstance(value, dict | list) or fault["type"] == "model_type":  # not one value of a known key
        (value,) = show([*seal({"": value}).values()])
    return f"{place} = {_short(value)}: {fault['msg']}"


def _place(loc: Sequence[int | str]) -> str:
    """Dotted path without the names that only tell one kind of codec from another."""
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc]
    tagged = [
        part
        for at, part in enumerate(parts)
        if not (at == 3 and parts[2] == ".codec")  # sensor.NAME.codec.TAG
    ]
    return "".join(tagged).lstrip(".")


def _meant(*loc: int | str) -> str:
    """The known key that an unknown one comes nearest to; the same stem with another unit comes first.

    One that only stands in the wrong table is told with the right ones.
    """
    key = str(loc[-1])
    if key in _KNOWN:
        has = (each for each in _SECTIONS if each is not Config and key in each.model_fields)
        right = {_table(each) for each in has} - {*loc[2:-1]}
        return f": did you mean {' or '.join(f'{table}.{key}' for table in sorted(right))}?" if right else ""
    stem = key.rsplit("_", 1)[0]
    same = [known for known in _KNOWN if known.rsplit("_", 1)[0] in (stem, key)]
    near = same or difflib.get_close_matches(key, _KNOWN, 1)
    return f": did you mean {min(near)}?" if near else ""


def _table(section: type[BaseModel]) -> str:
    """The table of a section, without what stands before it."""
    name = "cover" if section is Layer else section.__name__.lower()
    return name if name in Sensor.model_fields or name in Config.model_fields else "codec"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


FD_IF_TOLD = ("kvaser", "pcan", "socketcan", "vector")  # python-can's interfaces that speak CAN FD with fd = true


def _crossed(config: Config) -> Iterator[str]:
    """Faults between sections, and of what other packages know."""
    for name, each in config.bus.items():
        if fault := no_interface(each.interface):
            yield f"bus.{name}.interface = {_short(each.interface)}: {fault}"
    for name, sensor in config.sensor.items():
        if sensor.bus not in config.bus:
            yield f"sensor.{name}.bus = {sensor.bus!r}: no such bus: the file has {', '.join(config.bus)}"
        if not sensor.cover:
            yield f"sensor.{name}.cover = []: give at least one layer, top to bottom"
        yield from _clashes(name, sensor.codec.name)
        bus = config.bus.get(sensor.bus)
        if (
            bus
            and getattr(sensor.codec, "fd", False)
            and not bus.settings().get("fd")
            and bus.interface in FD_IF_TOLD
        ):
            yield f"sensor.{name}.codec.fd = true: bus {sensor.bus} is not CAN FD: set bus.{sensor.bus}.fd = true"


def _clashes(sensor: str, codec: str) -> Iterator[str]:
    """Codecs of other packages that bear a built-in's name."""
    for offer in plugins.offers():
        if offer.name == codec and codec in BUILT_IN:
            says = f"{plugins.package(offer)} offers a codec of the same name: rename or uninstall that one"
            yield f"sensor.{sensor}.codec.name = {codec!r}: built in, and {says}"
