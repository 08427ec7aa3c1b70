"""`/api/v1/sensors/{name}/calibration/file` and `history`: the calibration file in force, and those before it."""

from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Path, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from tactiled.calibrate.calibration_file import FILES_KEPT, CalibrationFile, max_bytes, read
from tactiled.errors import ConfigError
from tactiled.frames import CONFIGURED
from tactiled.live.sensor import Sensor
from tactiled.web import answers, calibration_schemas, schemas
from tactiled.web.http.problems import Problem
from tactiled.web.rest.dependencies import CurrentService, NamedSensor, applying
from tactiled.web.rest.openapi import CONTROL, MEDIA, Responses, problems

if TYPE_CHECKING:
    from tactiled.live.service import Service

router = APIRouter(prefix="/api/v1/sensors/{name}/calibration", tags=["sensors"])
CONTENT = {MEDIA["calibration"]: {"schema": {"type": "object"}}}
BODY = {"description": "a calibration file", "required": True, "content": CONTENT}
FILE: Responses = {200: {"description": "the file", "content": CONTENT}}
NUMBER = "1: the file before the present one; 0: the configured calibration, without a file"
FileNumber = Annotated[int, Path(ge=0, le=FILES_KEPT, description=NUMBER)]


class FormerCalibration(schemas.Schema):
    """A calibration that was in force before."""

    number: int = Field(description="1: the newest; 0: the configured one, without a file", examples=[1])
    id: str | None = Field(
        description="of number 0 `configured`; null: it cannot be read", examples=["3f9a0c52d1e7"]
    )
    created: str | None = Field(
        description="UTC, when its newest section was made", examples=["2026-11-22T08:30:00Z"]
    )
    sections: list[str] = Field(examples=[["gain", "cover"]])
    error: str | None = Field(None, description="why it cannot be read")


class CalibrationHistory(schemas.Schema):
    """Calibrations that were in force before: files, the newest first, then the configured one."""

    files: tuple[FormerCalibration, ...]


@router.get("/file", response_class=Response, responses=problems(404) | FILE)
def download(sensor: NamedSensor) -> Response:
    """Get the calibration file in force."""
    file = sensor.plan.file
    if file is None:
        raise Problem(404, f"sensor {sensor.name!r}: no calibration file is in force")
    headers = {"Content-Disposition": f'attachment; filename="{sensor.name}.json"', "Cache-Control": "no-cache"}
    return Response(file.text, media_type=MEDIA["calibration"], headers=headers)


@router.put("/file", responses=problems(404, 408, 413, 503, *CONTROL), openapi_extra={"requestBody": BODY})
async def upload(
    sensor: NamedSensor, service: CurrentService, request: Request
) -> calibration_schemas.SensorCalibration:
    """Calibrate by a file from the next frame on; the one before is kept as number 1 of the history.

    It is written where `calibration.file` is configured; else it holds until the service ends.
    """
    text, limit = await request.body(), max_bytes(sensor.plan.array.size)
    if len(text) > limit:
        raise Problem(413, f"a body of more than {limit >> 10} KiB: no calibration file of this array is as long")
    return await run_in_threadpool(_uploaded, service, sensor, text, request)


def _uploaded(
    service: "Service", sensor: Sensor, text: bytes, request: Request
) -> calibration_schemas.SensorCalibration:
    try:
        file = read(text)
    except ConfigError as error:
        raise ConfigError(f"body: {error}") from error
    return _applied(service, sensor, file, request)


@router.get("/history", responses=problems(404))
def history(sensor: NamedSensor, service: CurrentService) -> CalibrationHistory:
    """Get the calibration files before the present one, up to ten, and as number 0 the configured calibration."""
    files = service.former_calibrations(sensor.name).items()
    return CalibrationHistory(files=tuple(_former(n, each) for n, each in files))


@router.post("/history/{number}", responses=problems(404, 503, *CONTROL))
def apply_again(
    sensor: NamedSensor, service: CurrentService, request: Request, number: FileNumber
) -> calibration_schemas.SensorCalibration:
    """Calibrate by a former file again, or by 0 as configured: a written file then becomes number 1."""
    former = service.former_calibrations(sensor.name)
    if number not in former:
        raise Problem(404, f"sensor {sensor.name!r}: no former calibration {number}")
    file = former[number]
    if isinstance(file, str):
        raise ConfigError(f"former calibration {number}: {file}")
    return _applied(service, sensor, file, request)


def _applied(
    service: "Service", sensor: Sensor, file: CalibrationFile | None, request: Request
) -> calibration_schemas.SensorCalibration:
    with applying(service, sensor.name):
        service.apply_calibration(sensor.name, file)
    return answers.calibration(sensor, request.app.state.calibrations.way(sensor.name))


def _former(number: int, file: CalibrationFile | str | None) -> FormerCalibration:
    if file is None:
        return FormerCalibration(number=number, id=CONFIGURED, created=None, sections=[])
    if isinstance(file, str):
        return FormerCalibration(number=number, id=None, created=None, sections=[], error=file)
    return FormerCalibration(number=number, id=file.id, created=file.created, sections=[*file.sections])
