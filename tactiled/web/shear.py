"""`GET /api/v1/sensors/{name}/frames/shear`: what a 3-axis skin feels along its surface."""

from io import BytesIO
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from tactiled.bus.codecs import Shearing
from tactiled.sensor import State
from tactiled.web import answers, forms
from tactiled.web.common import NO_FRAME, NO_SENSOR, NOT_ACCEPTED, Found, Responses, accepted, documented, no_frame
from tactiled.web.problems import Problem

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


class Shear(forms.Form):
    """Shear of one frame, as the skin senses it under its cover: tared, not restored, not calibrated."""

    type: Literal["shear"] = "shear"
    sensor: forms.Name
    unit: Literal["counts"] = "counts"
    sequence: int = Field(examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])
    state: State
    x: forms.Values
    y: forms.Values


@router.get(
    "/sensors/{name}/frames/shear",
    response_model=Shear,
    responses=NO_SENSOR | NO_FRAME | NOT_ACCEPTED | SHEAR,
)
def shear(
    sensor: Found,
    request: Request,
    form: Annotated[Format | None, Query(alias="format", description="over the Accept header")] = None,
) -> Response:
    """Shear of the newest frame along the skin's own x and y, counts from rest; 404 where the skin feels none."""
    if not isinstance(sensor.codec, Shearing):
        raise Problem(404, f"sensor {sensor.name!r}: its codec {sensor.codec_name} carries no shear")
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
        out = BytesIO()
        np.save(out, image.shear)
        return Response(out.getvalue(), media_type=MEDIA[form], headers=headers)
    x, y = (answers.numbers(each) for each in image.shear)
    told = Shear(sensor=sensor.name, sequence=image.sequence, timestamp=image.time, state=state, x=x, y=y)
    return Response(told.model_dump_json(), media_type=MEDIA[form], headers=headers)
