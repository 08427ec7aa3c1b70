"""`GET /api/v1/sensors/{name}/frames/shear`: what a 3-axis skin feels along its surface."""

from typing import Annotated, Literal

from fastapi import APIRouter, Response

from tactiled.units import SHEAR
from tactiled.web import answers, schemas
from tactiled.web.rest.dependencies import AnySensor, format_of, no_frame
from tactiled.web.rest.frames import IMAGE_HEADERS, image_headers
from tactiled.web.rest.openapi import MEDIA, problems, success

Format = Literal["json", "npy"]
NEWEST = success(
    "the newest frame's shear; .npy: (2, rows, columns), or (2, taxels), float32", "npy", headers=IMAGE_HEADERS
)

router = APIRouter(prefix="/api/v1", tags=["frames"])


@router.get(
    "/sensors/{name}/frames/shear",
    response_model=schemas.Shear,
    responses=problems(404, 406, 503) | NEWEST,
)
def shear(sensor: AnySensor, form: Annotated[Format, format_of(Format)]) -> Response:
    """Shear of the newest frame along the skin's x and y axes, in counts; 404 if the skin has none."""
    sensor.need_shear()
    image = sensor.hub.latest()
    if image is None or image.shear is None:
        raise no_frame(sensor)
    headers = image_headers(image, sensor.status(), SHEAR)
    if form == "npy":
        return Response(answers.npy(image.shear), media_type=MEDIA[form], headers=headers)
    return Response(answers.shear(sensor, image).model_dump_json(), media_type=MEDIA[form], headers=headers)
