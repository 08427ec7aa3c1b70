"""`GET /api/v1/sensors/{name}/frames/shear`: what a 3-axis skin feels along its surface."""

from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from tactiled.frames import Image
from tactiled.runtime.sensor import Sensor, State
from tactiled.web import answers, schemas
from tactiled.web.rest.common import (
    NO_FRAME,
    NO_SHEAR,
    Found,
    Responses,
    accepted,
    documented,
    no_frame,
    not_accepted,
)

Format = Literal["json", "npy"]
MEDIA: dict[Format, str] = {"json": "application/json", "npy": "application/x-npy"}
HEADERS = {
    "X-Tactiled-Sequence": "number of the image",
    "X-Tactiled-Timestamp": "s, of the frame's first CAN message",
    "X-Tactiled-State": "live, stale or down",
    "X-Tactiled-Unit": "counts",
}
SHEAR: Responses = {
    200: {
        "description": "the newest frame's shear; .npy: (2, rows, columns), or (2, taxels), float32",
        "content": {MEDIA["npy"]: {"schema": {"type": "string", "format": "binary"}}},
        "headers": documented(HEADERS),
    }
}

router = APIRouter(prefix="/api/v1", tags=["frames"])


class Shear(schemas.Form):
    """Shear of one frame, as the skin senses it under its cover: tared, not restored, not calibrated."""

    type: Literal["shear"] = "shear"
    sensor: schemas.Name
    unit: Literal["counts"] = "counts"
    sequence: int = Field(examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])
    state: State
    x: schemas.Values
    y: schemas.Values


def told(sensor: Sensor, image: Image, state: State) -> Shear:
    """Shear of an image, which has it."""
    x, y = (answers.numbers(each) for each in np.asarray(image.shear))
    return Shear(sensor=sensor.name, sequence=image.sequence, timestamp=image.time, state=state, x=x, y=y)


@router.get(
    "/sensors/{name}/frames/shear",
    response_model=Shear,
    responses=NO_SHEAR | NO_FRAME | not_accepted(MEDIA) | SHEAR,
)
def shear(
    sensor: Found,
    request: Request,
    form: Annotated[
        Format | None, Query(alias="format", description="format of the answer; left out: by the Accept header")
    ] = None,
) -> Response:
    """Shear of the newest frame along the skin's x and y axes, in counts; 404 if the skin has none."""
    sensor.need_shear()
    form = form or accepted(request, MEDIA)
    image = sensor.hub.latest()
    if image is None or image.shear is None:
        raise no_frame(sensor)
    state = sensor.status().state
    headers = {
        "Cache-Control": "no-cache",
        "Vary": "Accept",
        "X-Tactiled-Sequence": str(image.sequence),
        "X-Tactiled-Timestamp": f"{image.time:.6f}",
        "X-Tactiled-State": state,
        "X-Tactiled-Unit": "counts",
    }
    if form == "npy":
        return Response(answers.npy(image.shear), media_type=MEDIA[form], headers=headers)
    return Response(told(sensor, image, state).model_dump_json(), media_type=MEDIA[form], headers=headers)
