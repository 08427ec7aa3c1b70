"""Tables of the configuration file, from the models that read it."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import BaseModel, TypeAdapter

from tactiled.bus import skins
from tactiled.config import schema
from tactiled.restore.methods import METHODS
from tests.docs.table import code, table

Json = dict[str, Any]
HEAD = ("Key", "Value", "Unit", "Default", "Meaning")
UNITS = {
    "_mm": "mm", "_mpa": "MPa", "_kpa": "kPa", "_s": "s", "_ms": "ms", "_hz": "1/s", "_mb": "MB",
    "kpa_per_count": "kPa", "shear_n_per_count": "N", "per_minute": "1/min",
    "no_load": "counts", "saturation": "counts",
}  # fmt: skip
TABLES: dict[str, type[BaseModel]] = {
    "[server]": schema.Server,
    "[bus.NAME]": schema.Bus,
    "[sensor.NAME]": schema.Sensor,
    "[sensor.NAME.array]": schema.Array,
    "[sensor.NAME.cover]` and `[sensor.NAME.substrate]": schema.Layer,
    "[sensor.NAME.kernel]": schema.Kernel,
    "[sensor.NAME.calibration]": schema.Calibration,
}


def tables() -> Iterator[str]:
    for name, model in TABLES.items():
        yield from ("", f"### `{name}`", "", *table(HEAD, rows(model)))


TABLES_OF_A_SENSOR = ("codec", "array", "cover", "substrate", "kernel", "calibration")


def models() -> dict[str, type]:
    """The settings of every codec of the package, by its name."""
    return {name: skins.load(name) for name in skins.BUILT_IN}


def codecs() -> Iterator[str]:
    listed = (
        [code(name), doc(model), ", ".join(map(code, keys(model))) or "–"] for name, model in models().items()
    )
    yield from table(("`codec.name`", "Skin", "Settings"), listed)


def codec_tables() -> Iterator[str]:
    for name, model in models().items():
        if keys(model):
            yield from ("", f"#### Settings of `{name}`", "", *table(HEAD, rows(model)))


def doc(model: type) -> str:
    return (model.__doc__ or "").splitlines()[0]


def keys(model: type) -> list[str]:
    return list(TypeAdapter(model).json_schema()["properties"])


def rows(model: type) -> Iterator[list[str]]:
    """One row a key that is no table of its own. KeyError where a key has no description."""
    for key, each in TypeAdapter(model).json_schema()["properties"].items():
        if key in TABLES_OF_A_SENSOR or key == "name":
            continue
        yield [code(key), form(key, each), unit(key), default(key, each), each["description"]]


def unit(key: str) -> str:
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def default(key: str, each: Json) -> str:
    if "default" not in each:
        return "required"
    if each["default"] is None:
        return "–"
    return code(hex(each["default"]) if key.endswith("base_id") else json.dumps(each["default"]))


def form(key: str, each: Json) -> str:
    """What a value may be, in words."""
    if key == "method":
        return choices(METHODS)
    if "anyOf" in each:
        return " or ".join(form(key, one) for one in each["anyOf"] if one.get("type") != "null")
    if "enum" in each or "const" in each:
        return choices(each.get("enum", [each.get("const")]))
    if each["type"] == "array":
        if "prefixItems" in each:
            return "pair of numbers"
        items = form(key, each["items"]).partition(",")
        return f"list of {items[0].replace('pair of', 'pairs of').rstrip('s')}s{''.join(items[1:])}"
    names = {"number": "number", "integer": "integer", "boolean": "`true`, `false`", "string": "string"}
    name = {"path": "path", "password": "secret"}.get(each.get("format", ""), names[each["type"]])
    return name + bounds(key, each)


def bounds(key: str, each: Json) -> str:
    if "minLength" in each and "maxLength" in each:
        return f", {each['minLength']} to {each['maxLength']} characters"
    write = hex if key.endswith("base_id") else (lambda value: np.format_float_positional(value, trim="-"))
    if "minimum" in each and "maximum" in each:
        return f", {write(each['minimum'])} to {write(each['maximum'])}"
    said = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "up to", "exclusiveMaximum": "below"}
    return "".join(f", {words} {write(each[bound])}" for bound, words in said.items() if bound in each)


def choices(values: Any) -> str:
    return ", ".join(code(json.dumps(value)) for value in values)
