"""What routes take from a request: the service, a sensor, the format; and the checks of every request."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args
from urllib.parse import unquote

from fastapi import Depends, Path, Query, Request, Response, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute
from starlette.requests import HTTPConnection

from tactiled.errors import PhysicsError, StateError
from tactiled.live.sensor import Sensor
from tactiled.units import PRESSURE
from tactiled.web.http.limits import Turns
from tactiled.web.http.problems import SOON, Problem
from tactiled.web.rest.openapi import MEDIA
from tactiled.web.views import PlanView, SensorView
from tactiled.web.ws.query import no_such, once

if TYPE_CHECKING:
    from tactiled.live.service import Service
else:
    Service = Any  # a server of readers elsewhere has none, and imports no python-can

Costly = Literal["pictures", "numbers", "playback"]  # answers of which one of a kind is made at a time
FORMAT = "format of the answer; left out: by the Accept header"


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


CurrentService = Annotated[Service, Depends(_service)]


async def _sensor(
    name: Annotated[str, Path(description="a sensor, as in the configuration", examples=["palm"])],
    service: CurrentService,
) -> Sensor:
    return service.sensor(unquote(name))


NamedSensor = Annotated[Sensor, Depends(_sensor)]
AnySensor = Annotated[SensorView, Depends(_sensor)]  # here or elsewhere


async def check_parameters(request: HTTPConnection) -> None:
    """Problem 422 for a query parameter that is unknown or given twice; FastAPI ignores both."""
    route = request.scope["route"]
    if request.scope["type"] != "http" or not request.query_params or not route.path.startswith("/api/"):
        return
    fields = get_flat_params(route.dependant)
    declared = [each.alias for each in fields if not isinstance(each.field_info, params.Path)]
    try:
        unknown = set(once(request.query_params)) - {*declared, "token"}
    except ValueError as error:
        raise Problem(422, str(error)) from error
    if unknown:
        raise Problem(422, no_such(min(unknown), declared))


async def check_body(request: HTTPConnection) -> None:
    """Problem 422 for a body of a request that takes none, unless it is empty or `{}`; FastAPI ignores it."""
    route = request.scope["route"]
    if not isinstance(request, Request) or request.method == "GET" or not isinstance(route, APIRoute):
        return
    if route.body_field or "requestBody" in (route.openapi_extra or {}):
        return
    body = (await request.body()).strip()
    if body not in (b"", b"{}"):
        raise Problem(422, f"body = {body.decode(errors='replace')!r:.80}: this request takes none")


def format_of(formats: Any) -> Any:
    """The dependency that gives one of `formats`: the parameter `format`, else by the Accept header."""

    async def form(
        request: Request, requested: Annotated[formats | None, Query(alias="format", description=FORMAT)] = None
    ) -> str:
        return requested or _accepted(request, get_args(formats))

    return Depends(form)


def _accepted(request: Request, offered: tuple[str, ...]) -> str:
    """The format that a request's Accept header prefers; Problem 406 where it accepts none."""
    header = request.headers.get("accept", "*/*")
    ranges = [_weighed(part) for part in header.split(",")]
    refused = {media for weight, media in ranges if weight == 0}
    for weight, media_range in sorted(ranges, key=lambda each: -each[0]):
        for form in offered:
            media = MEDIA[form]
            group = f"{media.partition('/')[0]}/*"
            if weight > 0 and media not in refused and media_range in (media, group, "*/*"):
                return form
    raise Problem(406, f"Accept: {header}: there are {', '.join(MEDIA[each] for each in offered)}")


def _weighed(part: str) -> tuple[float, str]:
    """How much a part of an Accept header likes which media type."""
    media, *parameters = (each.strip().lower() for each in part.split(";"))
    weight = next((each[2:] for each in parameters if each.startswith("q=")), "1")
    return (float(weight) if weight.isascii() and weight.replace(".", "", 1).isdigit() else 0.0), media


def in_unit(plan: PlanView, name: str, value: float | None, value_kpa: float | None) -> float | None:
    """A parameter in the unit of the sensor's pressure, sent as `name`, else in kPa as `name`_kpa.

    Problem 409 where kPa is sent of a sensor that is uncalibrated.
    """
    if value_kpa is not None and plan.unit != PRESSURE:
        raise Problem(409, f"{name}_kpa: sensor {plan.name!r} is uncalibrated: give {name}, in {plan.unit}")
    return value_kpa if value is None else value


def no_frame(sensor: SensorView) -> Problem:
    """Why there is no image yet."""
    return Problem(503, f"sensor {sensor.name!r}: {sensor.status().detail}", SOON)


def without_path(error: Exception | str, path: FilePath) -> str:
    """An error's text without a path: clients do not see where the service keeps its files."""
    return str(error).replace(f" {path}", "").replace(str(path), "").lstrip(": ")


@contextmanager
def keeping(service: Service) -> Iterator[None]:
    """Problem 409 in the block where the service keeps no state, 503 where its file cannot be written."""
    try:
        yield
    except StateError as error:
        if service.state is None:
            raise Problem(409, str(error)) from error
        raise Problem(503, without_path(error, service.state.path)) from error


@contextmanager
def applying(service: Service, name: str) -> Iterator[None]:
    """Problem 422 in the block where a sensor's calibration has no solution, 503 where it cannot be written."""
    path = service.config.sensor[name].calibration.file
    try:
        yield
    except PhysicsError as error:
        raise Problem(422, str(error)) from error
    except StateError as error:
        raise Problem(503, without_path(error, path) if path else str(error)) from error


async def in_turn(request: Request, make: Callable[[], Response], kind: Costly = "numbers") -> Response:
    """Make a costly answer, one of its kind at a time: many would keep every other answer waiting."""
    turns: dict[Costly, Turns] = request.app.state.turns
    return await turns[kind].one(request, make)
