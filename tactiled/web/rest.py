"""The REST resources under /api/v1."""

from io import BytesIO
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response

from tactiled.frames import Image
from tactiled.service import Sensor, Service
from tactiled.web import forms, picture
from tactiled.web.forms import Shown
from tactiled.web.problems import Problem

Format = Literal["json", "npy", "png"]
MEDIA: dict[Format, str] = {"json": "application/json", "npy": "application/x-npy", "png": "image/png"}
PROBLEM = {"model": forms.Problem, "content": {"application/problem+json": {}}}
NO_SENSOR: dict[int | str, dict[str, Any]] = {404: PROBLEM | {"description": "no such sensor"}}
FRAME: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "the newest image",
        "content": {
            MEDIA["npy"]: {"schema": {"type": "string", "format": "binary"}},
            MEDIA["png"]: {"schema": {"type": "string", "format": "binary"}},
        },
    },
    304: {"description": "If-None-Match names the newest image in its present state"},
    406: PROBLEM | {"description": "Accept names no format there is"},
    503: PROBLEM | {"description": "no frame yet; see Retry-After"},
}


router = APIRouter(
    prefix="/api/v1", responses={422: PROBLEM | {"description": "a parameter or the body is wrong"}}
)


def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


Served = Annotated[Service, Depends(_service)]


def _sensor(name: str, service: Served) -> Sensor:
    return service.sensor(name)


Found = Annotated[Sensor, Depends(_sensor)]


@router.get("/health", tags=["service"])
def health(service: Served) -> forms.Health:
    """Whether the service runs and every sensor is live; a stale one says since when."""
    return forms.health(service)


@router.get("/colormap", tags=["service"])
def colormap() -> forms.Colormap:
    """The colours of the viewer and of PNG images."""
    return forms.Colormap(name=picture.COLORS, colors=picture.colors())


@router.get("/sensors", tags=["sensors"])
def sensors(service: Served) -> forms.Sensors:
    """Every sensor and how it is doing."""
    return forms.Sensors(sensors=tuple(forms.sensor_state(each) for each in service.sensors.values()))


@router.get("/sensors/{name}", tags=["sensors"], responses=NO_SENSOR)
def sensor_state(sensor: Found) -> forms.SensorState:
    """One sensor and how it is doing."""
    return forms.sensor_state(sensor)


@router.get("/sensors/{name}/geometry", tags=["sensors"], responses=NO_SENSOR)
def geometry(sensor: Found) -> forms.Geometry:
    """Where the taxels and the surface cells are, mm."""
    return forms.geometry(sensor)


@router.get("/sensors/{name}/kernel", tags=["sensors"], responses=NO_SENSOR)
def kernel(sensor: Found) -> forms.KernelForm:
    """The cover: g(r), its gain G(q), and what they mean for this array."""
    return forms.kernel(sensor)


@router.get("/sensors/{name}/method", tags=["sensors"], responses=NO_SENSOR)
def get_method(sensor: Found) -> forms.Method:
    """The method asked for."""
    return forms.Method(method=sensor.method)


@router.put("/sensors/{name}/method", tags=["sensors"], responses=NO_SENSOR)
def put_method(sensor: Found, asked: forms.Method) -> forms.Method:
    """Restore by another method from the next frame on."""
    sensor.set_method(asked.method)
    return asked


@router.post("/sensors/{name}/tare", tags=["sensors"], status_code=202, responses=NO_SENSOR)
def tare(sensor: Found) -> None:
    """Take the mean of the next frames as the unloaded array."""
    sensor.tare()


@router.get("/sensors/{name}/contacts", tags=["frames"], responses=NO_SENSOR | {503: FRAME[503]})
def contacts(sensor: Found) -> forms.Contacts:
    """Where something touches: centre, force, area, axes, tracked from request to request."""
    found = forms.contacts(sensor)
    if found is None:
        raise _no_frame(sensor)
    return found


Top = Annotated[float | None, Query(gt=0, allow_inf_nan=False, description="PNG: end of the colour scale")]
Asked = Annotated[Format | None, Query(alias="format", description="over the Accept header")]


@router.get(
    "/sensors/{name}/frames/{kind}", tags=["frames"], response_model=forms.Frame, responses=NO_SENSOR | FRAME
)
def frame(sensor: Found, kind: Shown, request: Request, form: Asked = None, top_kpa: Top = None) -> Response:
    """The newest image, in kPa: raw, restored, or the restored one's standard deviation.

    What is known against it is in the JSON, or in X-Tactiled headers.
    """
    form = form or _accepted(request.headers.get("accept", "*/*"))
    image = sensor.hub.latest()
    if image is None:
        raise _no_frame(sensor)
    return _answer(sensor, image, kind, form, request, top_kpa)


def _no_frame(sensor: Sensor) -> Problem:
    return Problem(503, f"sensor {sensor.name!r}: {sensor.status().detail}", {"Retry-After": "1"})


def _accepted(header: str) -> Format:
    """The format that an Accept header likes best; Problem 406 where it likes none."""
    likes = [_like(part) for part in header.split(",")]
    for weight, media in sorted(likes, key=lambda like: -like[0]):
        for form, name in MEDIA.items():
            if weight > 0 and media in (name, name.split("/")[0] + "/*", "*/*"):
                return form
    raise Problem(406, f"Accept: {header}: there are {', '.join(MEDIA.values())}")


def _like(part: str) -> tuple[float, str]:
    """How much a part of an Accept header likes which media type."""
    media, *parameters = (each.strip().lower() for each in part.split(";"))
    weight = next((each[2:] for each in parameters if each.startswith("q=")), "1")
    return (float(weight) if weight.replace(".", "", 1).isdigit() else 0.0), media


def _answer(
    sensor: Sensor, image: Image, kind: Shown, form: Format, request: Request, top_kpa: float | None
) -> Response:
    status = sensor.status()
    tag = f'"{image.sequence}-{image.time:.6f}-{kind}-{form}-{status.state}-{top_kpa or ""}"'
    headers = {
        "ETag": tag,
        "Cache-Control": "no-cache",
        "Vary": "Accept",
        "X-Tactiled-Sequence": str(image.sequence),
        "X-Tactiled-Timestamp": f"{image.time:.6f}",
        "X-Tactiled-State": status.state,
        "X-Tactiled-Age": "" if status.age_s is None else f"{status.age_s:.3f}",
        "X-Tactiled-Unit": "kPa",
    }
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    if form == "png":
        content = picture.png(sensor, image, kind, top_kpa)
    elif form == "npy":
        out = BytesIO()
        np.save(out, forms.values(sensor, image, kind))
        content = out.getvalue()
    else:
        content = forms.frame(sensor, image, kind).model_dump_json().encode()
    return Response(content, media_type=MEDIA[form], headers=headers)
