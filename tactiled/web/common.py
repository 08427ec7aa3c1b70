"""What routes share: the service and its sensors, documented errors, the format that a client likes."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar, get_args

from fastapi import Depends, Request, Response

from tactiled.sensor import Sensor
from tactiled.service import Service
from tactiled.web.problems import Problem
from tactiled.web.rates import Rates, Turns

Responses = dict[int | str, dict[str, Any]]
F = TypeVar("F", bound=str)
Turn = Literal["pictures", "numbers"]


def documented(headers: Mapping[str, str]) -> dict[str, Any]:
    """How an answer's headers are documented, given their meaning by name."""
    return {name: {"description": text, "schema": {"type": "string"}} for name, text in headers.items()}


def problem(description: str, **headers: str) -> dict[str, Any]:
    """How an error is documented; `headers` by name with their meaning."""
    return {
        "description": description,
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
        "headers": documented({name.replace("_", "-"): text for name, text in headers.items()}),
    }


WAIT = "s until the next attempt"
NO_SENSOR: Responses = {404: problem("no such sensor")}
NO_SHEAR: Responses = {404: problem("no such sensor, or shear of one that feels none")}
NO_FRAME: Responses = {503: problem("no frame yet", Retry_After=WAIT)}
TOO_MANY: Responses = {
    429: problem("more than control_per_minute, or than can wait for their turn", Retry_After=WAIT)
}
CONTROL: Responses = TOO_MANY | {
    401: problem("no token, where one is needed", WWW_Authenticate="Bearer"),
    403: problem("a token that reads only, or a page of another site"),
}
BODY: Responses = {
    400: problem("the body is no JSON text"),
    408: problem("the body did not come in time"),
    413: problem("the body is too large"),
}
NOT_ACCEPTED: Responses = {406: problem("Accept names no format there is")}
WRONG: Responses = {422: problem("a parameter or the body is wrong")}


def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


Served = Annotated[Service, Depends(_service)]


def _sensor(name: str, service: Served) -> Sensor:
    return service.sensor(name)


Found = Annotated[Sensor, Depends(_sensor)]


def no_frame(sensor: Sensor) -> Problem:
    """Why there is no image yet."""
    return Problem(503, f"sensor {sensor.name!r}: {sensor.status().detail}", {"Retry-After": "1"})


def turns(rates: Rates) -> dict[Turn, Turns]:
    """What `in_turn` needs of an application."""
    return {each: Turns(rates) for each in get_args(Turn)}


async def in_turn(request: Request, make: Callable[[], Response], of: Turn = "numbers") -> Response:
    """Make a costly answer on a thread, one of its kind at a time: many would keep every other answer waiting."""
    turns: dict[Turn, Turns] = request.app.state.turns
    return await turns[of].one(request, make)


def accepted(request: Request, media: Mapping[F, str]) -> F:
    """The format that a request's Accept header likes best; Problem 406 where it likes none."""
    header = request.headers.get("accept", "*/*")
    likes = [_like(part) for part in header.split(",")]
    named = {liked for _, liked in likes}
    for weight, liked in sorted(likes, key=lambda like: -like[0]):
        for form, name in media.items():
            ranges = (name, name.split("/")[0] + "/*", "*/*")  # of which the narrowest that is named counts
            if weight > 0 and liked == next((each for each in ranges if each in named), None):
                return form
    raise Problem(406, f"Accept: {header}: there are {', '.join(media.values())}")


def _like(part: str) -> tuple[float, str]:
    """How much a part of an Accept header likes which media type."""
    media, *parameters = (each.strip().lower() for each in part.split(";"))
    weight = next((each[2:] for each in parameters if each.startswith("q=")), "1")
    return (float(weight) if weight.isascii() and weight.replace(".", "", 1).isdigit() else 0.0), media
