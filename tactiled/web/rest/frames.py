"""`GET /api/v1/sensors/{name}/frames`: the images of the last seconds."""

from collections.abc import Iterator
from io import BytesIO
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray
from pydantic import Field

from tactiled.runtime.history import Page
from tactiled.runtime.sensor import Sensor
from tactiled.web import answers, schemas
from tactiled.web.rest.common import (
    NO_SHEAR,
    TOO_MANY,
    Found,
    Responses,
    accepted,
    documented,
    in_turn,
    not_accepted,
)
from tactiled.wire import UNITS, Kind, Unit

Format = Literal["json", "npy", "npz"]
MEDIA: dict[Format, str] = {"json": "application/json", "npy": "application/x-npy", "npz": "application/x-npz"}
MOST = 1000  # images an answer
MOST_VALUES: dict[Format, int] = {"json": 1 << 18, "npy": 1 << 21, "npz": 1 << 21}  # numbers an answer
BINARY = {"schema": {"type": "string", "format": "binary"}}


Flags = Annotated[
    list[list[int]] | list[int] | None,
    Field(
        description="a raw taxel's 1 missing + 2 bad + 4 dead + 8 saturated; null where all are 0", examples=[None]
    ),
]


class KeptFrame(schemas.Form):
    """One image of the last seconds."""

    sequence: int = Field(description="lost frames leave gaps", examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])
    method: str = Field(description="that restored it", examples=["nnls"])
    values: schemas.Values
    flags: Flags


class KeptShear(schemas.Form):
    """What was felt along the surface in one frame of the last seconds, counts."""

    sequence: int = Field(description="lost frames leave gaps", examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])
    x: schemas.Values
    y: schemas.Values
    flags: Flags


class Frames(schemas.Form):
    """Images of the last seconds, oldest first."""

    type: Literal["frames"] = "frames"
    sensor: schemas.Name
    kind: Kind = Field(examples=["restored"])
    unit: Unit = Field(description="counts of shear", examples=["kPa"])
    before: str | None = Field(
        description="ask for these next: older images of the same window, NUMBER@SINCE; null: there are none",
        examples=["5073@1763711998.250000"],
    )
    cut: bool = Field(
        description="whether images of the window's beginning may be kept no longer", examples=[False]
    )
    frames: list[KeptFrame] | list[KeptShear]


HEADERS = {
    "X-Tactiled-Unit": "kPa; of shear counts",
    "X-Tactiled-Sequence": "numbers of the images, as ranges: 5-9,12 where 10 and 11 were lost",
    "X-Tactiled-Timestamp": "s, of the first image and of the last",
    "X-Tactiled-Before": "ask for these next; absent: there are none",
    "X-Tactiled-Cut": "true: images of the window's beginning may be kept no longer; else absent",
}
RESPONSES: Responses = {
    200: {
        "description": "images, oldest first: .npy (T, rows, columns), shear (T, 2, rows, columns); "
        ".npz with sequence, time, method, flags and values",
        "content": {MEDIA["npy"]: BINARY, MEDIA["npz"]: BINARY},
        "headers": documented(HEADERS),
    }
}
Last = Annotated[
    str,
    Query(
        pattern=r"^[0-9]{1,6}(\.[0-9]{1,6})?s$",
        description="length of the window, back from the newest image",
        examples=["2s"],
    ),
]
Before = Annotated[
    str | None,
    Query(
        pattern=r"^[0-9]{1,18}(@-?[0-9]{1,15}\.[0-9]{6})?$",
        description="continue with older images: `before` of the previous answer, or a sequence number",
        examples=["5073@1763711998.250000"],
    ),
]
Limit = Annotated[int, Query(ge=1, le=MOST, description="images in one answer; fewer if they are large")]

router = APIRouter(prefix="/api/v1", tags=["frames"])


@router.get(
    "/sensors/{name}/frames",
    response_model=Frames,
    responses=NO_SHEAR | not_accepted(MEDIA) | TOO_MANY | RESPONSES,
)
async def frames(
    sensor: Found,
    request: Request,
    kind: Annotated[Kind, Query(description="which images")] = "restored",
    last: Last = "1s",
    before: Before = None,
    limit: Limit = 100,
    form: Annotated[
        Format | None, Query(alias="format", description="format of the answer; left out: by the Accept header")
    ] = None,
) -> Response:
    """The images of the last seconds in kPa, or their shear in counts, for up to `history_s` seconds.

    The first page has the newest images, each page is in order, and `before` leads to the next page of the same
    window; `cut` reports that images at the window's start may have been discarded.
    """
    form = form or accepted(request, MEDIA)
    if kind == "shear":
        sensor.need_shear()

    number, since = _place(before)
    seconds, most = float(last[:-1]), MOST_VALUES[form]

    def answer() -> Response:
        return _answer(sensor, kind, form, sensor.history.page(kind, seconds, number, limit, most, since))

    return await in_turn(request, answer)


def _before(kept: Page) -> str | None:
    """Where the next page begins: the number that it stays below, and the beginning of the window."""
    return f"{kept.sequence[0]}@{kept.since:.6f}" if kept.older else None


def _place(before: str | None) -> tuple[int | None, float | None]:
    """What `_before` says."""
    number, _, since = (before or "").partition("@")
    return int(number) if number else None, float(since) if since else None


def _answer(sensor: Sensor, kind: Kind, form: Format, kept: Page) -> Response:
    headers = {"X-Tactiled-Unit": UNITS[kind], "X-Tactiled-Sequence": _ranges(kept.sequence), "Vary": "Accept"}
    if len(kept.time):
        headers["X-Tactiled-Timestamp"] = f"{kept.time[0]:.6f},{kept.time[-1]:.6f}"
    if before := _before(kept):
        headers["X-Tactiled-Before"] = before
    if kept.cut:
        headers["X-Tactiled-Cut"] = "true"
    return Response(_content(sensor, kind, kept, form), media_type=MEDIA[form], headers=headers)


def _content(sensor: Sensor, kind: Kind, kept: Page, form: Format) -> bytes:
    if form == "json":
        return b"".join(_json(sensor, kind, kept))
    if form == "npy":
        return answers.npy(kept.values)
    out = BytesIO()
    method = np.array(kept.method, str)
    np.savez(out, sequence=kept.sequence, time=kept.time, method=method, flags=kept.flags, values=kept.values)
    return out.getvalue()


def _json(sensor: Sensor, kind: Kind, kept: Page) -> Iterator[bytes]:
    """`Frames`, an image at a time: one call for all of them would keep the live images waiting."""
    head = Frames(sensor=sensor.name, kind=kind, unit=UNITS[kind], before=_before(kept), cut=kept.cut, frames=[])
    yield head.model_dump_json().encode().removesuffix(b"]}")
    for n in range(len(kept.time)):
        yield (b"," if n else b"") + _one(kind, kept, n).model_dump_json().encode()
    yield b"]}"


def _one(kind: Kind, kept: Page, n: int) -> KeptFrame | KeptShear:
    """Fill in the form of image `n`."""
    sequence, timestamp = int(kept.sequence[n]), float(kept.time[n])
    flags = kept.flags[n].tolist() if kept.flags[n].any() else None
    if kind == "shear":
        x, y = (answers.numbers(each) for each in kept.values[n])
        return KeptShear(sequence=sequence, timestamp=timestamp, x=x, y=y, flags=flags)
    return KeptFrame(
        sequence=sequence,
        timestamp=timestamp,
        method=kept.method[n],
        values=answers.numbers(kept.values[n]),
        flags=flags,
    )


def _ranges(numbers: NDArray[np.int64]) -> str:
    """Ascending numbers, those in a row written as first-last."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1) if len(numbers) else []
    told = [f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
    return ",".join(told)
