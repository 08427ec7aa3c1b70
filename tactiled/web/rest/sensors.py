"""The REST resources under /api/v1."""

from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from tactiled.errors import StateError
from tactiled.frames import Image
from tactiled.runtime.pipeline import TARE_FRAMES
from tactiled.runtime.sensor import Sensor
from tactiled.web import answers, schemas
from tactiled.web.http.negotiation import named
from tactiled.web.http.problems import Problem
from tactiled.web.rest import picture
from tactiled.web.rest.common import (
    BODY,
    CONTROL,
    NO_FRAME,
    NO_SENSOR,
    TOO_MANY,
    WRONG,
    Found,
    Responses,
    Served,
    accepted,
    documented,
    in_turn,
    no_frame,
    not_accepted,
    problem,
)
from tactiled.web.rest.constant import RESPONSES as CONSTANT
from tactiled.web.rest.constant import constant
from tactiled.web.schemas import Shown

Format = Literal["json", "npy", "png"]
MEDIA: dict[Format, str] = {"json": "application/json", "npy": "application/x-npy", "png": "image/png"}
BINARY = {"schema": {"type": "string", "format": "binary"}}
HEADERS = {
    "ETag": "for If-None-Match: the image in its present state",
    "X-Tactiled-Sequence": "number of the image",
    "X-Tactiled-Timestamp": "s, of the frame's first CAN message",
    "X-Tactiled-State": "live, stale or down",
    "X-Tactiled-Age": "s since the last frame came in",
    "X-Tactiled-Unit": "kPa",
}
TOLD = documented(HEADERS)
FRAME: Responses = {
    200: {
        "description": "the newest image",
        "content": {MEDIA["npy"]: BINARY, MEDIA["png"]: BINARY},
        "headers": TOLD,
    },
    304: {"description": "If-None-Match names the newest image in its present state", "headers": TOLD},
}

router = APIRouter(prefix="/api/v1", responses=WRONG)


@router.get("/health", tags=["service"])
def health(service: Served) -> schemas.Health:
    """State of the service and of every sensor, with the age of the last frame, and faults of its parts."""
    return answers.health(service)


@router.get("/colormap", tags=["service"], response_model=schemas.Colormap, responses=CONSTANT)
async def colormap(request: Request) -> Response:
    """The 256 colours of the viewer and of PNG images."""
    return await constant(request, lambda: _json(schemas.Colormap(name=picture.COLORS, colors=picture.colors())))


@router.get("/sensors", tags=["sensors"])
def sensors(service: Served) -> schemas.Sensors:
    """Every sensor with its state, age, rate, method and loss counts."""
    return schemas.Sensors(sensors=tuple(answers.sensor_state(each) for each in service.sensors.values()))


@router.get("/sensors/{name}", tags=["sensors"], responses=NO_SENSOR)
def sensor_state(sensor: Found) -> schemas.SensorState:
    """One sensor with its state, age, rate, method and loss counts."""
    return answers.sensor_state(sensor)


@router.get(
    "/sensors/{name}/geometry", tags=["sensors"], response_model=schemas.Geometry, responses=NO_SENSOR | CONSTANT
)
async def geometry(sensor: Found, request: Request) -> Response:
    """Positions of the taxels and the cells of the images, in mm."""
    return await constant(request, lambda: _json(answers.geometry(sensor)))


@router.get(
    "/sensors/{name}/kernel", tags=["sensors"], response_model=schemas.KernelForm, responses=NO_SENSOR | CONSTANT
)
async def kernel(sensor: Found, request: Request) -> Response:
    """The cover's kernel g(r), its gain G(q), and the smallest resolvable gap."""
    return await constant(request, lambda: _json(answers.kernel(sensor)))


@router.get("/sensors/{name}/method", tags=["sensors"], responses=NO_SENSOR)
def get_method(sensor: Found, service: Served) -> schemas.Method:
    """The selected method, the configured one and the kept one."""
    return answers.method(service, sensor)


NO_STATE = "keep = true: this service keeps no state: `tactiled run` does"
KEEP: Responses = {
    409: problem("this service keeps no state", NO_STATE),
    503: problem("the state cannot be written", "state: No space left on device: nothing was kept"),
}


@router.put("/sensors/{name}/method", tags=["sensors"], responses=NO_SENSOR | KEEP | CONTROL | BODY)
def put_method(sensor: Found, service: Served, asked: schemas.MethodAsked) -> schemas.Method:
    """Select a method: it applies from the next frame on, with `keep` also after a restart."""
    if asked.keep and service.state is None:
        raise Problem(409, NO_STATE)
    try:
        service.set_method(sensor.name, asked.method, asked.keep)
    except StateError as error:
        raise Problem(503, str(error).replace(f" {service.state and service.state.path}:", ":")) from error
    return answers.method(service, sensor)


@router.get("/sensors/{name}/calibration", tags=["sensors"], responses=NO_SENSOR)
def calibration(sensor: Found) -> schemas.CalibrationForm:
    """The present calibration from counts to kPa: as configured, with `no_load` from the last tare."""
    return answers.calibration(sensor)


NOT_LIVE: Responses = {
    409: problem(
        "the sensor is not live; or its newest frames show a load, which code = loaded and seen tell, and "
        "force=true tares anyway",
        "sensor 'palm': stale, no frame for 0.6 s: a tare needs frames",
    )
}
Force = Annotated[bool, Query(description="tare even where the newest frames show a load")]


@router.post("/sensors/{name}/tare", tags=["sensors"], status_code=202, responses=NO_SENSOR | NOT_LIVE | CONTROL)
def tare(sensor: Found, service: Served, force: Force = False) -> schemas.Tare:
    """Tare: the mean of the next 16 frames becomes no load, and an event reports the end.

    It is refused while the newest frames show a load: a contact above noise and scatter, or readings that move;
    `force=true` tares anyway. If the sensor does not stay live, the tare lapses, and an event reports that.
    """
    service.tare(sensor.name, force)
    return schemas.Tare(frames=TARE_FRAMES)


@router.get("/sensors/{name}/contacts", tags=["frames"], responses=NO_SENSOR | NO_FRAME)
def contacts(sensor: Found) -> schemas.Contacts:
    """The contacts: centre, force, area, peak, axes, and an id that stays while the contact lasts."""
    found = answers.contacts(sensor)
    if found is None:
        raise no_frame(sensor)
    return found


Top = Annotated[
    float | None,
    Query(
        ge=1e-6,
        le=1e9,
        allow_inf_nan=False,
        description="kPa at the end of the colour scale of a PNG; left out: from the image",
    ),
]
Asked = Annotated[
    Format | None, Query(alias="format", description="format of the answer; left out: by the Accept header")
]


@router.get(
    "/sensors/{name}/frames/{kind}",
    tags=["frames"],
    response_model=schemas.Frame,
    responses=NO_SENSOR | NO_FRAME | not_accepted(MEDIA) | TOO_MANY | FRAME,
)
async def frame(sensor: Found, kind: Shown, request: Request, form: Asked = None, top_kpa: Top = None) -> Response:
    """The newest image in kPa: raw, restored, or the standard deviation of the restored one.

    The JSON holds state, flags, noise and warnings; `X-Tactiled-` headers give state and age of every format.
    """
    form = form or accepted(request, MEDIA)
    _, headers = _newest(sensor, kind, form, top_kpa)
    if named(headers["ETag"], request.headers.get("if-none-match", "")):
        return Response(status_code=304, headers=headers)
    answer = partial(_answer, sensor, kind, form, top_kpa)
    if form == "png" or kind == "deviation":
        return await in_turn(request, answer, "pictures" if form == "png" else "numbers")
    return await run_in_threadpool(answer)


def _newest(sensor: Sensor, kind: Shown, form: Format, top_kpa: float | None) -> tuple[Image, dict[str, str]]:
    """The newest image, and the headers that tell of it."""
    image = sensor.hub.latest()
    if image is None:
        raise no_frame(sensor)
    status = sensor.status()
    return image, {
        "ETag": f'W/"{image.sequence}-{image.time:.6f}-{kind}-{form}-{status.state}-{top_kpa or ""}"',
        "Cache-Control": "no-cache",
        "Vary": "Accept",
        "X-Tactiled-Sequence": str(image.sequence),
        "X-Tactiled-Timestamp": f"{image.time:.6f}",
        "X-Tactiled-State": status.state,
        "X-Tactiled-Age": "" if status.age_s is None else f"{status.age_s:.3f}",
        "X-Tactiled-Unit": "kPa",
    }


def _answer(sensor: Sensor, kind: Shown, form: Format, top_kpa: float | None) -> Response:
    image, headers = _newest(sensor, kind, form, top_kpa)
    if form == "png":
        content = picture.png(sensor, image, kind, top_kpa)
    elif form == "npy":
        content = answers.npy(answers.values(sensor, image, kind))
    else:
        content = answers.frame(sensor, image, kind).model_dump_json().encode()
    return Response(content, media_type=MEDIA[form], headers=headers)


def _json(form: schemas.Form) -> bytes:
    return form.model_dump_json().encode()
