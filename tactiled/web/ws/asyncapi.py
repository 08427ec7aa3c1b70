"""`/api/v1/asyncapi.json`: the WebSockets in AsyncAPI 3.0, from the models that their messages are made of."""

from functools import cache
from itertools import permutations
from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from tactiled import __version__
from tactiled.web import schemas as forms
from tactiled.web.rest.constant import Constant, text
from tactiled.web.rest.openapi import example
from tactiled.web.rest.shear import Shear
from tactiled.web.ws import session, xela
from tactiled.wire import KINDS, LAYOUT, PRESSURES

Json = dict[str, Any]

ABOUT = """Live images of covered tactile arrays, and how their sensors are doing.

Newest wins: nothing queues for a client that does not read. Where tokens are configured, a client shows one as
`Authorization: Bearer TOKEN` or `?token=TOKEN`. REST is described in `openapi.json`."""
TOLD: dict[str, tuple[type[BaseModel], str]] = {
    "status": (forms.StreamStatus, "A sensor's state, at least once a second and on every change"),
    "contacts": (forms.Contacts, "With contacts=1: where something touches, at most twenty times a second"),
    "frame": (forms.Frame, "With format=json: one image"),
    "shear": (Shear, "With format=json and shear among the kinds: what a 3-axis skin feels along its surface"),
}
XELAS: dict[str, tuple[type[BaseModel], str]] = {
    "welcome": (xela.Welcome, "The first message"),
    "routine": (xela.Routine, "The newest frame of every live module with the codec xela, under its number"),
}
QUERY: Json = {
    "kinds": {
        "type": "string",
        "enum": [",".join(some) for n in range(1, len(KINDS) + 1) for some in permutations(KINDS, n)],
        "default": ",".join(PRESSURES),
        "description": "images of each frame, sent in this order; shear only from a 3-axis skin",
    },
    "rate_hz": {
        "type": "number",
        "minimum": 0,
        "maximum": 10000,
        "default": 0,
        "description": "largest rate of images of one sensor, 1/s; 0: every frame",
    },
    "format": {
        "type": "string",
        "enum": ["binary", "json"],
        "default": "binary",
        "description": "format of the images",
    },
    "flow": {
        "type": "string",
        "enum": ["newest", "credit"],
        "default": "newest",
        "description": "when images are sent: newest at once, or one of each kind per `next` message",
    },
    "contacts": {"type": "string", "enum": ["0", "1"], "default": "0", "description": "1: contacts as well"},
    "together": {
        "type": "string",
        "enum": ["0", "1"],
        "default": "0",
        "description": "1, with format=binary: all images of a frame in one message, each with its own header",
    },
    "token": {"type": "string", "description": "token, if the service needs one"},
}
SENSORS: Json = {
    "type": "string",
    "description": "sensors, with commas between; left out: all",
    "examples": ["palm,tip"],
}


SHEAR: Json = {
    "type": "string",
    "description": "sensors whose shear is sent after their other images, with commas between",
    "examples": ["tip"],
}


def make() -> APIRouter:
    """The route."""
    router = APIRouter(prefix="/api/v1")

    @router.get("/asyncapi.json", include_in_schema=False)  # a description is no resource
    def asyncapi(request: Request) -> Response:
        """The WebSockets of this service in AsyncAPI 3.0."""
        made = document(request.url.netloc, secure=request.url.scheme == "https")
        return Constant(text(made)).answer(request)

    return router


def document(host: str, secure: bool = False) -> Json:
    """The description of the service at `host`."""
    return _anywhere() | {"servers": {"here": {"host": host, "protocol": "wss" if secure else "ws"}}}


@cache
def _anywhere() -> Json:
    """The description of the service, wherever it is."""
    models: list[type[BaseModel]] = [*(model for model, _ in (TOLD | XELAS).values()), forms.Next]
    _, schemas = models_json_schema(
        [(model, "serialization") for model in models], ref_template="#/components/schemas/{model}"
    )
    one, several = "/api/v1/sensors/{name}/stream", "/api/v1/stream"
    return {
        "asyncapi": "3.0.0",
        "info": {"title": "tactiled", "version": __version__, "description": ABOUT},
        "defaultContentType": "application/json",
        "channels": {
            "sensor": _channel(one, "Images of one sensor", QUERY)
            | {
                "parameters": {
                    "name": {"description": "of the sensor, as in the configuration", "examples": ["palm"]}
                }
            },
            "sensors": _channel(
                several,
                "Images of several sensors; every message names its own",
                QUERY | {"sensors": SENSORS, "shear": SHEAR},
            ),
            "xela": _xela(),
        },
        "operations": {
            f"{verb}{channel.capitalize()}": _operation(action, channel, messages)
            for channel in ("sensor", "sensors")
            for verb, action, messages in (("show", "send", ["image", *TOLD]), ("ask", "receive", ["next"]))
        }
        | {"showXela": _operation("send", "xela", [*XELAS])},
        "components": {"schemas": schemas["$defs"], "messages": _messages(schemas["$defs"])},
    }


def _xela() -> Json:
    """The WebSocket of XELA's clients, who say nothing that could be wrong."""
    about = "The JSON of XELA's own server, at / as well; what a client says is not heard"
    made = _channel("/xela", about, {"token": QUERY["token"]}, (*XELAS,))
    codes = [each for each in made["x-close-codes"] if each["code"] != session.BAD_REQUEST]
    return made | {"x-close-codes": codes}


def _channel(address: str, about: str, query: Json, messages: tuple[str, ...] = ("image", *TOLD, "next")) -> Json:
    """A WebSocket, its address's parameters and why it may close."""
    return {
        "address": address,
        "description": f"{about}. One that is refused is opened all the same, to be told why: see x-close-codes.",
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in messages},
        "bindings": {
            "ws": {
                "method": "GET",
                "query": {"type": "object", "properties": query, "additionalProperties": False},
            }
        },
        "x-close-codes": [{"code": code, "description": why} for code, why in session.CLOSES.items()],
    }


def _operation(action: str, channel: str, messages: list[str]) -> Json:
    return {
        "action": action,
        "channel": {"$ref": f"#/channels/{channel}"},
        "messages": [{"$ref": f"#/channels/{channel}/messages/{name}"} for name in messages],
    }


def _messages(schemas: Json) -> Json:
    told = {name: _message(name, model, about, schemas) for name, (model, about) in (TOLD | XELAS).items()}
    image = {
        "title": "image",
        "summary": "One image, little-endian; with together=1 all images of a frame, one behind the other",
        "contentType": "application/octet-stream",
        "payload": {"type": "string", "format": "binary"},
        "x-layout": [dict(zip(("offset", "type", "meaning"), each, strict=True)) for each in LAYOUT],
    }
    asked = _message("next", forms.Next, "With flow=credit: requests the next image", schemas)
    return told | {"image": image, "next": asked}


def _message(name: str, model: type[BaseModel], about: str, schemas: Json) -> Json:
    """A message whose payload is a form, with an example."""
    return {
        "title": name,
        "summary": about,
        "payload": {"$ref": f"#/components/schemas/{model.__name__}"},
        "examples": [{"payload": example(schemas[model.__name__], schemas)}],
    }
