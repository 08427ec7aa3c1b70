"""`/api/v1/asyncapi.json`: the WebSockets in AsyncAPI 3.0, from the models that their messages are made of."""

from collections.abc import Iterable
from copy import deepcopy
from functools import cache
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from tactiled import __version__
from tactiled.web import schemas
from tactiled.web.ws import push, session
from tactiled.web.ws.query import SensorsQuery, StreamQuery
from tactiled.wire import LAYOUT

Json = dict[str, Any]
router = APIRouter()

ABOUT = """Live images of covered tactile arrays, and how their sensors are doing.

Newest wins: nothing queues for a client that does not read. Where tokens are configured, a client shows one as
`Authorization: Bearer TOKEN` or `?token=TOKEN`. REST is described in `openapi.json`."""
MESSAGES: dict[str, tuple[type[BaseModel], str]] = {
    "status": (schemas.StreamStatus, "A sensor's state, at least once a second and on every change"),
    "contacts": (schemas.Contacts, "With contacts=1: where something touches, at most twenty times a second"),
    "frame": (schemas.Frame, "With format=json: one image"),
    "shear": (
        schemas.Shear,
        "With format=json and shear among the kinds: what a 3-axis skin feels along its surface",
    ),
    "traction": (schemas.Traction, "With format=json and traction among the kinds: the same, restored"),
}


def parameters(form: type[StreamQuery]) -> Json:
    """The query parameters of a stream, by name."""
    described: Json = form.model_json_schema()["properties"]
    for each in described.values():
        del each["title"]
        if "anyOf" in each:  # an address has no null
            each |= each.pop("anyOf")[0]
        if each.get("default") in (None, []):
            each.pop("default", None)
    return described


TOKEN = {"token": parameters(StreamQuery)["token"]}  # the only parameter of most other WebSockets


@router.get("/api/v1/asyncapi.json", include_in_schema=False)  # a description is no resource
def asyncapi(request: Request) -> JSONResponse:
    """The WebSockets of this service in AsyncAPI 3.0."""
    server = {"host": request.url.netloc, "protocol": "wss" if request.url.scheme == "https" else "ws"}
    document = deepcopy(_anywhere())
    for each in request.app.state.bridges:
        described = each.described()
        document["components"]["messages"] |= described.pop("messages", {})
        for part, named in described.items():
            document[part] |= named
    return JSONResponse(document | {"servers": {"here": server}})


@cache
def _anywhere() -> Json:
    """The description of the service, wherever it is."""
    models: list[type[BaseModel]] = [*(model for model, _ in MESSAGES.values()), schemas.Next, schemas.PushedFrame]
    _, defined = models_json_schema(
        [(model, "serialization") for model in models], ref_template="#/components/schemas/{model}"
    )
    name = {"description": "of the sensor, as in the configuration", "examples": ["palm"]}
    one = channel("/api/v1/sensors/{name}/stream", "Images of one sensor", parameters(StreamQuery))
    about = "Images of several sensors; every message names its own"
    several = channel("/api/v1/stream", about, parameters(SensorsQuery))
    operations = {"takeFrames": operation("receive", "push", ["pushed", "pushedBytes"])}
    for stream in ("sensor", "sensors"):
        operations[f"show{stream.capitalize()}"] = operation("send", stream, ["image", *MESSAGES])
        operations[f"ask{stream.capitalize()}"] = operation("receive", stream, ["next"])
    return {
        "asyncapi": "3.0.0",
        "info": {"title": "tactiled", "version": __version__, "description": ABOUT},
        "defaultContentType": "application/json",
        "channels": {
            "sensor": one | {"parameters": {"name": name}},
            "sensors": several,
            "push": _push() | {"parameters": {"name": name}},
        },
        "operations": operations,
        "components": {"schemas": defined["$defs"], "messages": _messages()},
    }


def _push() -> Json:
    """The WebSocket that takes frames."""
    about = "Frames of a sensor without `bus` and `codec`; needs the control token, and answers nothing"
    return channel("/api/v1/sensors/{name}/push", about, TOKEN, ("pushed", "pushedBytes"))


def channel(
    address: str, about: str, query: Json, messages: tuple[str, ...] = ("image", *MESSAGES, "next")
) -> Json:
    """A WebSocket, its address's parameters and why it may close."""
    properties = {"type": "object", "properties": query, "additionalProperties": False}
    return {
        "address": address,
        "description": f"{about}. A refused one is opened first, so that the client reads why: see x-close-codes.",
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in messages},
        "bindings": {"ws": {"method": "GET", "query": properties}},
        "x-close-codes": [{"code": code, "description": why} for code, why in session.CLOSES.items()],
    }


def operation(action: str, channel: str, messages: list[str]) -> Json:
    """Messages that the service sends, or takes, on a channel."""
    return {
        "action": action,
        "channel": {"$ref": f"#/channels/{channel}"},
        "messages": [{"$ref": f"#/channels/{channel}/messages/{name}"} for name in messages],
    }


def _messages() -> Json:
    models = MESSAGES | {
        "next": (schemas.Next, "With flow=credit: requests the next image"),
        "pushed": (schemas.PushedFrame, "A frame, as in POST /api/v1/sensors/{name}/frames"),
    }
    image = _binary(
        "image", "One image, little-endian; with together=1 all images of a frame, one behind the other", LAYOUT
    )
    pushed = _binary("pushedBytes", "One frame, little-endian", push.LAYOUT)
    return {"image": image, "pushedBytes": pushed} | {
        name: {"title": name, "summary": about, "payload": {"$ref": f"#/components/schemas/{model.__name__}"}}
        for name, (model, about) in models.items()
    }


def _binary(title: str, about: str, layout: Iterable[tuple[object, ...]]) -> Json:
    return {
        "title": title,
        "summary": about,
        "contentType": "application/octet-stream",
        "payload": {"type": "string", "format": "binary"},
        "x-layout": [dict(zip(("offset", "type", "meaning"), each, strict=True)) for each in layout],
    }
