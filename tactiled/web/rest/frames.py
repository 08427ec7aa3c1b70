"""`/api/v1/sensors/{name}/frames`: the newest image or shear, and those of the last seconds."""

from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response
from numpy.typing import NDArray
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from tactiled.bounds import Syntax
from tactiled.frames import SensorImage
from tactiled.live.history import Page
from tactiled.live.status import Status
from tactiled.units import PRESSURE, SHEAR, Unit
from tactiled.web import answers, schemas
from tactiled.web.rest import drawing
from tactiled.web.rest.dependencies import AnySensor, NamedSensor, format_of, in_turn, in_unit, no_frame
from tactiled.web.rest.drawing import Picture
from tactiled.web.rest.openapi import MEDIA, problems, success
from tactiled.web.schemas import PressureKind
from tactiled.web.views import SensorView
from tactiled.wire import Kept, values_of

NewestFormat = Literal["json", "npy", "png"]
ShearFormat = Literal["json", "npy"]
PageFormat = Literal["json", "npy", "npz"]
MAX_IMAGES = 1000  # an answer
WINDOW = Syntax(r"^[0-9]{1,6}(\.[0-9]{1,6})?s$", "seconds, such as 2s or 0.5s")
PAGE_END = "`before` of the previous answer, or a sequence number"
BEFORE = Syntax(r"^[0-9]{1,18}(@-?[0-9]{1,15}\.[0-9]{6})?$", PAGE_END)
OLDER = f"continue with older images: {PAGE_END}"
MAX_VALUES: dict[PageFormat, int] = {"json": 1 << 18, "npy": 1 << 21, "npz": 1 << 21}  # numbers an answer
TOP: dict[str, Any] = {"ge": 1e-6, "le": 1e9, "allow_inf_nan": False}
TOP_OF = "end of the colour scale of a PNG"

SERIES_HEADERS = {
    "X-Tactiled-Sequence": "number of the image; of several as ranges: 5-9,12 where 10 and 11 were lost",
    "X-Tactiled-Timestamp": "s, of the frame's first CAN message; of several images, of the first and the last",
    "X-Tactiled-Unit": "kPa, or counts of an uncalibrated sensor; of shear counts",
}
IMAGE_HEADERS = SERIES_HEADERS | {
    "X-Tactiled-State": "live, stale, silent or down",
    "X-Tactiled-Age": "s since the last frame came in",
    "X-Tactiled-Calibration": "id of the calibration file, or configured",
}
TAGGED = {"ETag": "for If-None-Match: the image in its present state"} | IMAGE_HEADERS
NEWEST = success("the newest image", "npy", "png", headers=TAGGED) | success(
    "If-None-Match names the newest image in its present state", status=304, headers=TAGGED
)
NEWEST_SHEAR = success(
    "the newest frame's shear; .npy: (2, rows, columns), or (2, taxels), float32", "npy", headers=IMAGE_HEADERS
)
NEWEST_TRACTION = success(
    "the newest frame's restored shear; .npy: (2, rows, columns), float32", "npy", headers=IMAGE_HEADERS
)
NEWEST_SURFACE = success(
    "the newest image and its deviation; .npy: (2, rows, columns), float32", "npy", headers=IMAGE_HEADERS
)
PAGE = success(
    "images, oldest first: .npy (T, rows, columns), shear (T, 2, rows, columns); "
    ".npz with sequence, time, method, flags and values",
    "npy",
    "npz",
    headers=SERIES_HEADERS
    | {
        "X-Tactiled-Before": "`before` of the next page; absent: there is none",
        "X-Tactiled-Cut": "true: images of the window's beginning may have been discarded; else absent",
    },
)

MIN_TOP_SIGMAS = 15.0  # the scale of a picture reaches at least so far above the noise, as in the viewer
MIN_TOP = 1e-6  # kPa, or counts
router = APIRouter(prefix="/api/v1/sensors/{name}/frames", tags=["frames"])


class PastFrame(schemas.FrameId):
    """An image of the last seconds."""

    flags: schemas.Flags | None = Field(description="null where all are 0", examples=[None])


class KeptFrame(PastFrame):
    """One pressure image of the last seconds."""

    method: str = Field(description="method used", examples=["nnls"])
    values: schemas.Values


class KeptShear(PastFrame):
    """Shear of one frame of the last seconds, counts."""

    x: schemas.Values
    y: schemas.Values


class Frames(schemas.Schema):
    """Images of the last seconds, oldest first."""

    type: Literal["frames"] = "frames"
    sensor: schemas.SensorName
    kind: Kept = Field(examples=["restored"])
    unit: Unit = Field(description="counts of shear, and of an uncalibrated sensor", examples=["kPa"])
    before: str | None = Field(description="`before` of the next page; null: no older images in the window")
    cut: bool = Field(description="whether images of the window's beginning may have been discarded")
    frames: list[KeptFrame] | list[KeptShear]


class PageQuery(BaseModel):
    """Which images of the last seconds."""

    kind: Kept = Field("restored", description="which images")
    last: Annotated[str, WINDOW] = Field("1s", description="window, back from the newest image", examples=["2s"])
    before: Annotated[str, BEFORE] | None = Field(None, description=OLDER, examples=["37545@72076.529173"])
    limit: int = Field(100, ge=1, le=MAX_IMAGES, description="images in one answer; fewer if they are large")
    image: schemas.ImageCells = Field("raster", description=schemas.IMAGE_CELLS)


@router.get("", response_model=Frames, responses=problems(404, 406, 429) | PAGE)
async def page(
    sensor: AnySensor,
    request: Request,
    query: Annotated[PageQuery, Query()],
    form: Annotated[PageFormat, format_of(PageFormat)],
) -> Response:
    """Get the images of the last seconds, in `unit`, or their shear in counts, for up to `history_s` seconds.

    The first page has the newest images, each page is in order, and `before` leads to the next page of the window.
    """
    if query.kind == "shear":
        sensor.need_shear()
    number, _, since = (query.before or "").partition("@")

    def answer() -> Response:
        images = sensor.history.page(
            query.kind,
            float(query.last.removesuffix("s")),
            int(number) if number else None,
            query.limit,
            MAX_VALUES[form],
            float(since) if since else None,
        )
        if query.kind == "restored" and query.image == "taxels":
            images = images._replace(values=answers.by_taxel(sensor, images.values))
        return _page(sensor, query.kind, form, images)

    return await in_turn(request, answer)


def _page(sensor: SensorView, kind: Kept, form: PageFormat, images: Page) -> Response:
    headers = {
        "X-Tactiled-Unit": _unit(sensor, kind, images),
        "X-Tactiled-Sequence": _ranges(images.sequence),
        "Vary": "Accept",
    }
    if len(images.time):
        headers["X-Tactiled-Timestamp"] = f"{images.time[0]:.6f},{images.time[-1]:.6f}"
    if before := _before(images):
        headers["X-Tactiled-Before"] = before
    if images.cut:
        headers["X-Tactiled-Cut"] = "true"
    if form == "json":
        content = b"".join(_json(sensor, kind, images))
    elif form == "npy":
        content = answers.npy(images.values)
    else:
        out = BytesIO()
        arrays = {name: getattr(images, name) for name in ("sequence", "time", "flags", "values")}
        np.savez(out, **arrays, method=np.array(images.method, str))
        content = out.getvalue()
    return Response(content, media_type=MEDIA[form], headers=headers)


def _unit(sensor: SensorView, kind: Kept, images: Page) -> Unit:
    return SHEAR if kind == "shear" else images.unit or sensor.plan.unit


def _before(images: Page) -> str | None:
    """Where the next page begins: the number that it stays below, and the beginning of the window."""
    return f"{images.sequence[0]}@{images.since:.6f}" if images.older else None


def _json(sensor: SensorView, kind: Kept, images: Page) -> Iterator[bytes]:
    """`Frames`, an image at a time: one call for all of them would keep the live images waiting."""
    before, unit = _before(images), _unit(sensor, kind, images)
    head = Frames(sensor=sensor.name, kind=kind, unit=unit, before=before, cut=images.cut, frames=[])
    yield head.model_dump_json().encode().removesuffix(b"]}")
    for n in range(len(images.time)):
        yield (b"," if n else b"") + _past_frame(kind, images, n).model_dump_json().encode()
    yield b"]}"


def _past_frame(kind: Kept, images: Page, n: int) -> PastFrame:
    flags, values = images.flags[n], images.values[n]
    fields = {
        "sequence": int(images.sequence[n]),
        "timestamp": float(images.time[n]),
        "flags": flags.tolist() if flags.any() else None,
    }
    if kind == "shear":
        return KeptShear(**fields, x=answers.numbers(values[0]), y=answers.numbers(values[1]))
    return KeptFrame(**fields, method=images.method[n], values=answers.numbers(values))


def _ranges(numbers: NDArray[np.int64]) -> str:
    """Ascending numbers, those in a row written as first-last."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1) if len(numbers) else []
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)


@router.get("/surface", response_model=schemas.Surface, responses=problems(404, 406, 429, 503) | NEWEST_SURFACE)
async def surface(
    sensor: NamedSensor, request: Request, form: Annotated[ShearFormat, format_of(ShearFormat)]
) -> Response:
    """Get the newest restored image with what lies beyond the taxels, in `unit`, and its standard deviation."""
    image = sensor.hub.latest()
    if image is None:
        raise no_frame(sensor)
    headers = image_headers(image, sensor.status(), image.unit)

    def answer() -> Response:
        if form == "npy":
            return Response(answers.npy(sensor.surface(image)), media_type=MEDIA[form], headers=headers)
        return Response(answers.surface(sensor, image).model_dump_json(), media_type=MEDIA[form], headers=headers)

    return await in_turn(request, answer, "numbers")


@router.get("/shear", response_model=schemas.Shear, responses=problems(404, 406, 503) | NEWEST_SHEAR)
def shear(sensor: AnySensor, form: Annotated[ShearFormat, format_of(ShearFormat)]) -> Response:
    """Get the shear of the newest frame along the skin's x and y axes, in counts; 404 if the skin has none."""
    sensor.need_shear()
    image = sensor.hub.latest()
    if image is None or image.shear is None:
        raise no_frame(sensor)
    headers = image_headers(image, sensor.status(), SHEAR)
    if form == "npy":
        return Response(answers.npy(image.shear), media_type=MEDIA[form], headers=headers)
    return Response(answers.shear(sensor, image).model_dump_json(), media_type=MEDIA[form], headers=headers)


@router.get("/traction", response_model=schemas.Traction, responses=problems(404, 406, 503) | NEWEST_TRACTION)
def traction(sensor: AnySensor, form: Annotated[ShearFormat, format_of(ShearFormat)]) -> Response:
    """Get the shear of the newest frame, restored on the cells, in kPa; 404 where it is not. NaN before a tare."""
    sensor.need_traction()
    image = sensor.hub.latest()
    if image is None:
        raise no_frame(sensor)
    headers = image_headers(image, sensor.status(), PRESSURE)
    if form == "npy":
        return Response(answers.npy(values_of(image, "traction")), media_type=MEDIA[form], headers=headers)
    return Response(answers.traction(sensor, image).model_dump_json(), media_type=MEDIA[form], headers=headers)


@router.get("/{kind}", response_model=schemas.Frame, responses=problems(404, 406, 409, 429, 503) | NEWEST)
async def newest(
    sensor: AnySensor,
    kind: Annotated[
        PressureKind, Path(description="what the taxels measure, the pressure on the cover, or its deviation")
    ],
    request: Request,
    form: Annotated[NewestFormat, format_of(NewestFormat)],
    image: Annotated[
        schemas.ImageCells, Query(description=f"{schemas.IMAGE_CELLS}; a PNG is the raster")
    ] = "raster",
    top: Annotated[
        float | None, Query(**TOP, description=f"{TOP_OF}, in `unit`; left out: from the image")
    ] = None,
    top_kpa: Annotated[
        float | None, Query(**TOP, description=f"{TOP_OF} of a calibrated sensor, kPa, unless `top` is given")
    ] = None,
) -> Response:
    """Get the newest image, in `unit`: raw, restored, or the standard deviation of the restored one.

    The JSON holds state, flags, noise and warnings; `X-Tactiled-` headers give state and age of every format.
    """
    top = in_unit(sensor.plan, "top", top, top_kpa)
    _, headers = _newest(sensor, kind, form, top, image)
    if _names(request.headers.get("if-none-match", ""), headers["ETag"]):
        return Response(status_code=304, headers=headers)  # polling an unchanged image costs nothing
    png = partial(request.app.state.drawing.run, drawing.png)
    answer = partial(_newest_image, sensor, kind, form, top, image, png)
    if form == "png" or kind == "deviation":
        return await in_turn(request, answer, "pictures" if form == "png" else "numbers")
    return await run_in_threadpool(answer)


def _names(header: str, tag: str) -> bool:
    """Whether an If-None-Match header names a tag; weak and strong ones are the same there."""
    tags = {each.strip().removeprefix("W/") for each in header.split(",")}
    return bool(tags & {tag.removeprefix("W/"), "*"})


def image_headers(image: SensorImage, status: Status, unit: Unit) -> dict[str, str]:
    """The headers of a newest image: no client can take an old one for a new one, in any format."""
    return {
        "Cache-Control": "no-cache",
        "Vary": "Accept",
        "X-Tactiled-Sequence": str(image.sequence),
        "X-Tactiled-Timestamp": f"{image.time:.6f}",
        "X-Tactiled-State": status.state,
        "X-Tactiled-Age": "" if status.age_s is None else f"{status.age_s:.3f}",
        "X-Tactiled-Calibration": image.calibration,
        "X-Tactiled-Unit": unit,
    }


def _newest(
    sensor: SensorView, kind: PressureKind, form: NewestFormat, top: float | None, cells: schemas.ImageCells
) -> tuple[SensorImage, dict[str, str]]:
    """The newest image and its headers."""
    image = sensor.hub.latest()
    if image is None:
        raise no_frame(sensor)
    status = sensor.status()
    tag = f"{image.sequence}-{image.time:.6f}-{kind}-{form}-{status.state}-{top or ''}-{cells}"
    return image, image_headers(image, status, image.unit) | {"ETag": f'W/"{tag}"'}


def _newest_image(
    sensor: SensorView,
    kind: PressureKind,
    form: NewestFormat,
    top: float | None,
    cells: schemas.ImageCells,
    png: Callable[[drawing.Picture], bytes],
) -> Response:
    image, headers = _newest(sensor, kind, form, top, cells)
    if form == "png":
        content = png(picture(sensor, image, kind, top))
    elif form == "npy":
        content = answers.npy(answers.pressures(sensor, image, kind, cells))
    else:
        content = answers.frame(sensor, image, kind, cells).model_dump_json().encode()
    return Response(content, media_type=MEDIA[form], headers=headers)


def picture(sensor: SensorView, image: SensorImage, kind: PressureKind, top: float | None) -> Picture:
    """An image from 0 to `top`, in its unit (default: its own peak, where that stands out of the noise)."""
    values, status = answers.pressures(sensor, image, kind), sensor.status()
    age = "" if status.state == "live" else f"\n{status.state.upper()}: {status.age_s or 0.0:.1f} s old"
    return Picture(
        title=f"{image.sensor}, {kind}, frame {image.sequence}{age}",
        legend=f"{'standard deviation' if kind == 'deviation' else 'pressure'} ({image.unit})",
        values=values,
        top=top or _peak(image, kind, values),
        positions=sensor.array.positions if kind == "raw" else sensor.cells.positions,
        pitch=sensor.array.pitch if kind == "raw" else sensor.cells.side,
        width=sensor.array.width,
    )


def _peak(image: SensorImage, kind: PressureKind, values: NDArray[np.float32]) -> float:
    """End of the scale, on which noise alone is dark."""
    peak = max(float(np.nanmax(values, initial=0.0)), MIN_TOP)
    if kind == "deviation":
        return peak
    gain = max(1.0, image.noise_gain) if np.isfinite(image.noise_gain) else 1.0
    return max(peak, MIN_TOP_SIGMAS * gain * image.noise)
