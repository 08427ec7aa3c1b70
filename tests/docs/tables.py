"""Tables that the code prints: settings, REST, streams, metrics, the command line."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import typer.main
from pydantic import SecretStr, TypeAdapter

from tactiled.bus import skins
from tactiled.cli.app import app as cli
from tactiled.cli.demo import demo_config
from tactiled.config import Server
from tactiled.config import schema as config
from tactiled.live.service import Service
from tactiled.restore.methods import METHODS
from tactiled.web.app import create
from tactiled.web.http.connection_limit import Places
from tactiled.web.rest import metrics as prometheus
from tactiled.web.ws.asyncapi import parameters as query_parameters
from tactiled.web.ws.query import SensorsQuery, StreamQuery
from tactiled.web.ws.session import CLOSES
from tactiled.wire import LAYOUT
from tests.docs.markdown import code, codes, is_block, is_table, sentence, table

KEYS = ("Key", "Value", "Default", "Meaning")
MODELS = {
    "[server]": config.Server,
    "[zenoh]": config.Zenoh,
    "[bus.NAME]": config.Bus,
    "[sensor.NAME]": config.Sensor,
    "[sensor.NAME.array]": config.Array,
    "[sensor.NAME.cover]` and `[sensor.NAME.substrate]": config.Layer,
    "[sensor.NAME.kernel]": config.Kernel,
    "[sensor.NAME.calibration]": config.Calibration,
}
SUBTABLES = ("codec", "array", "cover", "substrate", "kernel", "calibration")
KINDS = {"kinds": "some of `raw`, `restored`, `shear`, `traction`, each once, with commas between"}


def unquoted(value):
    return json.dumps(value).strip('"')


def decimal(value):
    return np.format_float_positional(value, trim="-")


def form(each, text=unquoted, number=decimal):
    """What a value may be, in words, from its JSON schema; `text` and `number` write one."""
    if "anyOf" in each:
        return " or ".join(form(one, text, number) for one in each["anyOf"] if one.get("type") != "null")
    if "enum" in each or "const" in each:
        return codes(text(one) for one in each.get("enum", [each.get("const")]))
    if each["type"] == "array":
        if "prefixItems" in each:
            count = len(each["prefixItems"])
            return "pair of numbers" if count == 2 else f"{count} numbers"
        item, *rest = form(each["items"], text, number).partition(",")
        return f"list of {item.replace('pair of', 'pairs of').rstrip('s')}s{''.join(rest)}"
    name = {"path": "path", "password": "secret"}.get(each.get("format"), each["type"])
    if name == "boolean":
        return "`true`, `false`"
    if "minLength" in each and "maxLength" in each:
        return f"{name}, {each['minLength']} to {each['maxLength']} characters"
    if "exclusiveMinimum" in each and "maximum" in each:
        return f"{name}, above {number(each['exclusiveMinimum'])} to {number(each['maximum'])}"
    return f"{name}, {number(each['minimum'])} to {number(each['maximum'])}" if "minimum" in each else name


def rows(model):
    """One row a key that is no table of its own. KeyError where a key has no description."""
    for key, each in TypeAdapter(model).json_schema()["properties"].items():
        if key not in (*SUBTABLES, "name"):
            number = hex if key.endswith("base_id") else decimal
            value = codes(map(json.dumps, METHODS)) if key == "method" else form(each, json.dumps, number)
            yield code(key), value, default(each, hex if number is hex else json.dumps), each["description"]


def default(each, write=unquoted):
    if each.get("default") is None:
        return "–" if "default" in each else "required"
    return code(write(each["default"]))


@is_block
def settings():
    for name, model in MODELS.items():
        yield from ("", f"### `{name}`", "", *table(KEYS, rows(model)))


@is_table("`codec.name`", "Skin")
def codecs():
    for name in skins.BUILT_IN:
        yield code(name), skins.load(name).__doc__.splitlines()[0]


@is_block
def codec_settings():
    for name in skins.BUILT_IN:
        if keys := list(rows(skins.load(name))):
            yield from ("", f"#### Settings of `{name}`", "", *table(KEYS, keys))


@cache
def app():
    """The application with all of its routes."""
    return create(Service(demo_config()), Server(recordings=Path("recordings"), control_token=SecretStr("c" * 16)))


def operations():
    """Every request and what OpenAPI says of it, by its path."""
    for path, verbs in sorted(app().openapi()["paths"].items()):
        for verb, operation in verbs.items():
            yield code(f"{verb.upper()} {path.removeprefix('/api/v1')}"), operation


@is_table("Request", "Parameters", "Answer")
def routes():
    for request, each in operations():
        names = codes(one["name"] for one in each.get("parameters", ()) if one["in"] == "query")
        yield request, names, " ".join(each["description"].split())


@is_table("Parameter", "Value", "Default", "Meaning")
def stream_parameters():
    for name, each in query_parameters(SensorsQuery).items():
        where = "" if name in StreamQuery.model_fields else "Only on `/stream`: "
        yield (
            code(name),
            KINDS.get(name) or form(each),
            default({"default": None} | each),
            sentence(where + each["description"]),
        )


@is_table("Metric", "Type", "Meaning")
def metrics():
    state = app().state
    lines = [
        line.split(maxsplit=3)
        for line in prometheus.text(state.service, state.streams, Places(1)).decode().splitlines()
    ]
    types = {words[2]: words[3] for words in lines if words[:2] == ["#", "TYPE"]}
    for name, text in (words[2:] for words in lines if words[:2] == ["#", "HELP"]):
        if name.startswith("tactiled_"):
            yield code(name), types[name], sentence(text)


@is_table("Offset", "Type", "Meaning")
def stream_header():
    for at, kind, text in LAYOUT:
        yield "then" if at is None else str(at), kind, sentence(text)


@is_table("Code", "Reason")
def close_codes():
    for number, reason in CLOSES.items():
        yield str(number), reason


@is_block
def verbs():
    commands = typer.main.get_command(cli).commands
    yield from table(
        ("Command", "Does"),
        ((code(f"tactiled {name}"), each.help or each.short_help) for name, each in sorted(commands.items())),
    )
    yield from ("", f"`tactiled bench` has {codes(sorted(commands['bench'].commands))}.")
