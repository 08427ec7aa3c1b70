"""What routes share: the service and its sensors, documented errors, the format that a client likes."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar, get_args

from fastapi import Depends, Path, Request, Response, params
from fastapi.dependencies.utils import get_flat_params
from starlette.requests import HTTPConnection

from tactiled.runtime.sensor import Sensor
from tactiled.runtime.service import Service
from tactiled.web.http.body import BODY_TIMEOUT_S, MAX_BODY_BYTES
from tactiled.web.http.limits import RateLimit, Turns
from tactiled.web.http.negotiation import like
from tactiled.web.http.problems import Problem
from tactiled.web.ws.query import no_such, once

Responses = dict[int | str, dict[str, Any]]
F = TypeVar("F", bound=str)
Turn = Literal["pictures", "numbers"]


def documented(headers: Mapping[str, str]) -> dict[str, Any]:
    """How an answer's headers are documented, given their meaning by name."""
    return {name: {"description": text, "schema": {"type": "string"}} for name, text in headers.items()}


def problem(description: str, detail: str, **headers: str) -> dict[str, Any]:
    """How an error is documented, with a detail that has come; `headers` by name with their meaning."""
    content = {"schema": {"$ref": "#/components/schemas/Problem"}, "example": detail}  # made whole in the end
    return {
        "description": description,
        "content": {"application/problem+json": content},
        "headers": documented({name.replace("_", "-"): text for name, text in headers.items()}),
    }


WAIT = "s until the next attempt"
NO_SENSOR: Responses = {404: problem("no such sensor", "sensor 'plam': no such sensor: there are palm")}
NO_SHEAR: Responses = {
    404: problem(
        "no such sensor, or shear of one that feels none", "sensor 'palm': its codec packed carries no shear"
    )
}
NO_FRAME: Responses = {503: problem("no frame yet", "sensor 'palm': no frame yet on can0", Retry_After=WAIT)}
TOO_MANY: Responses = {
    429: problem(
        "more than control_per_minute, or than can wait for their turn",
        "more than 600 a minute: wait",
        Retry_After=WAIT,
    )
}
CONTROL: Responses = TOO_MANY | {
    403: problem(
        "a token that reads only, or a page of another site",
        "this token reads only: show the control token to change anything",
    )
}
LATE: Responses = {
    408: problem("the body did not come in time", f"the body did not come within {BODY_TIMEOUT_S:g} s"),
    413: problem("the body is too large", f"a body of more than {MAX_BODY_BYTES >> 10} KiB: send it in parts"),
}
BODY: Responses = LATE | {
    400: problem("the body is no JSON text", "body: no JSON at character 0: Expecting value"),
    415: problem("the body is not said to be JSON", "Content-Type: text/plain: give application/json"),
}
WRONG: Responses = {  # of every resource
    401: problem(
        "no token, where one is needed",
        "a token is needed: Authorization: Bearer TOKEN, or open /?token=TOKEN in a browser",
        WWW_Authenticate="Bearer",
    ),
    403: problem(
        "a page of another site; on loopback, another host name than loopback's",
        "Origin: https://elsewhere.example: pages of another site may not use this service",
    ),
    422: problem("a parameter or the body is wrong", ""),  # whose example tells the parameters there are
}


async def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


Served = Annotated[Service, Depends(_service)]


SensorName = Annotated[str, Path(description="a sensor, as in the configuration", examples=["palm"])]


async def _sensor(name: SensorName, service: Served) -> Sensor:
    return service.sensor(name)


Found = Annotated[Sensor, Depends(_sensor)]


async def declared(asked: HTTPConnection) -> None:
    """Problem 422 where a query has a parameter that its resource has not, or one twice, of which one counted."""
    route = asked.scope["route"]
    if asked.scope["type"] != "http" or not asked.query_params or not route.path.startswith("/api/"):
        return
    fields = get_flat_params(route.dependant)
    there = [each.alias for each in fields if isinstance(each.field_info, params.Query)]
    try:
        unknown = set(once(asked.query_params)) - {*there, "token"}
    except ValueError as error:
        raise Problem(422, str(error)) from error
    if unknown:
        raise Problem(422, no_such(min(unknown), there))


def no_frame(sensor: Sensor) -> Problem:
    """Why there is no image yet."""
    return Problem(503, f"sensor {sensor.name!r}: {sensor.status().detail}", {"Retry-After": "1"})


def turns(rates: RateLimit) -> dict[Turn, Turns]:
    """What `in_turn` needs of an application."""
    return {each: Turns(rates) for each in get_args(Turn)}


async def in_turn(request: Request, make: Callable[[], Response], of: Turn = "numbers") -> Response:
    """Make a costly answer, one of its kind at a time: many would keep every other answer waiting."""
    turns: dict[Turn, Turns] = request.app.state.turns
    return await turns[of].one(request, make)


def not_accepted(media: Mapping[F, str]) -> Responses:
    """How it is documented that `accepted` finds none."""
    return {406: problem("Accept names no format there is", _none_of("text/html", media))}


def _none_of(header: str, media: Mapping[F, str]) -> str:
    return f"Accept: {header}: there are {', '.join(media.values())}"


def accepted(request: Request, media: Mapping[F, str]) -> F:
    """The format that a request's Accept header likes best; Problem 406 where it likes none."""
    header = request.headers.get("accept", "*/*")
    likes = [like(part) for part in header.split(",")]
    named = {liked for _, liked in likes}
    for weight, liked in sorted(likes, key=lambda like: -like[0]):
        for form, name in media.items():
            ranges = (name, name.split("/")[0] + "/*", "*/*")  # of which the narrowest that is named counts
            if weight > 0 and liked == next((each for each in ranges if each in named), None):
                return form
    raise Problem(406, _none_of(header, media))
