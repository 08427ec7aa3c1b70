"""Tables of what programs and people call: REST, streams, metrics, the command line."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import typer.main
from pydantic import SecretStr

from tactiled.cli.app import app as cli
from tactiled.cli.demo import demo_config
from tactiled.config import Server
from tactiled.runtime.service import Service
from tactiled.web.app import create
from tactiled.web.http.places import Places
from tactiled.web.rest import metrics as prometheus
from tactiled.web.ws.asyncapi import parameters as query_parameters
from tactiled.web.ws.query import SensorsQuery, StreamQuery
from tactiled.web.ws.session import CLOSES
from tactiled.wire import LAYOUT
from tests.docs.table import code, sentence, table

Json = dict[str, Any]
BASE = "/api/v1"


@cache
def app() -> Any:
    """The application with all of its routes."""
    return create(Service(demo_config()), Server(recordings=Path("recordings"), control_token=SecretStr("c" * 16)))


def operations() -> Iterator[tuple[str, Json]]:
    """Every request and what OpenAPI says of it, by its path."""
    for path, verbs in sorted(app().openapi()["paths"].items()):
        for verb, operation in verbs.items():
            yield code(f"{verb.upper()} {path.removeprefix(BASE)}"), operation


def routes() -> Iterator[str]:
    def rows() -> Iterator[list[str]]:
        for request, operation in operations():
            told = " ".join(operation["description"].split())
            yield [request, told, ", ".join(sorted(operation["responses"]))]

    yield from table(("Request", "Answer", "Status codes"), rows())


def parameters() -> Iterator[str]:
    def rows() -> Iterator[list[str]]:
        for request, operation in operations():
            for each in operation.get("parameters", ()):
                if each["in"] == "query":
                    yield [request, code(each["name"]), *value(each), sentence(each["description"])]

    yield from table(("Request", "Parameter", "Value", "Default", "Meaning"), rows())


def value(parameter: Json) -> tuple[str, str]:
    """What a query parameter may be, and its default."""
    schema = parameter["schema"]
    one = next((each for each in schema.get("anyOf", [schema]) if each.get("type") != "null"), schema)
    default = code(json.dumps(schema["default"]).strip('"')) if schema.get("default") is not None else "–"
    if "enum" in one:
        form = ", ".join(map(code, one["enum"]))
    elif "minimum" in one:
        low, high = (np.format_float_positional(one[bound], trim="-") for bound in ("minimum", "maximum"))
        form = f"{one['type']}, {low} to {high}"
    else:
        form = one["type"] + (f" such as {code(schema['examples'][0])}" if "examples" in schema else "")
    return form, "required" if parameter["required"] else default


def metrics() -> Iterator[str]:
    web = app()
    lines = prometheus.text(web.state.service, web.state.streams, Places(1)).splitlines()
    kinds = {line.split()[2]: line.split()[3] for line in lines if line.startswith("# TYPE")}
    helps = (line.split(maxsplit=3)[2:] for line in lines if line.startswith("# HELP"))
    yield from table(
        ("Metric", "Type", "Meaning"), ([code(name), kinds[name], sentence(says)] for name, says in helps)
    )


def stream_parameters() -> Iterator[str]:
    rows: list[list[str]] = []
    for name, each in query_parameters(SensorsQuery).items():
        form = "string"
        if name == "kinds":
            form = "some of `raw`, `restored`, `shear`, each once, with commas between"
        elif "enum" in each:
            form = ", ".join(map(code, each["enum"]))
        elif "minimum" in each:
            form = f"{each['type']}, {each['minimum']} to {each['maximum']}"
        default = code(each["default"]) if "default" in each else "–"
        several = "" if name in StreamQuery.model_fields else "Only on `/stream`: "
        rows.append([code(name), form, default, sentence(several + each["description"])])
    yield from table(("Parameter", "Value", "Default", "Meaning"), rows)


def stream_header() -> Iterator[str]:
    rows = (["then" if at is None else str(at), form, sentence(says)] for at, form, says in LAYOUT)
    yield from table(("Offset", "Type", "Meaning"), rows)


def close_codes() -> Iterator[str]:
    yield from table(("Code", "Reason"), ([str(number), why] for number, why in CLOSES.items()))


def verbs() -> Iterator[str]:
    group: Any = typer.main.get_command(cli)
    rows = [
        [code(f"tactiled {name}"), each.help or each.short_help] for name, each in sorted(group.commands.items())
    ]
    bench = ", ".join(map(code, sorted(group.commands["bench"].commands)))
    yield from table(("Command", "Does"), rows)
    yield ""
    yield f"`tactiled bench` has {bench}."
