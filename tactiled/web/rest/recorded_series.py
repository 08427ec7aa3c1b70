"""`/api/v1/recordings/{name}/series`: what a recording's restored images hold in total and in regions."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any, Literal

from pydantic import BaseModel, Field
from starlette.responses import Response, StreamingResponse

from tactiled.archive import csv_table
from tactiled.contacts.regions import TOTAL, Measures, Region, headings
from tactiled.live.sensor import Sensor
from tactiled.recorded.frames import RecordedFrames
from tactiled.recorded.playback import Playback
from tactiled.recorded.series import ROWS_AT_ONCE, RecordedSeries, SeriesJob, SeriesRows, SeriesRuns, Summary
from tactiled.restore.methods import named
from tactiled.units import FORCE_UNITS, ForceUnit
from tactiled.web import schemas
from tactiled.web.http.problems import SOON, Problem
from tactiled.web.rest.dependencies import without_path
from tactiled.web.rest.openapi import MEDIA
from tactiled.web.rest.regions import MISSING_TAXELS, csv_lines, watched


class SensorQuery(BaseModel):
    """Whose frames."""

    sensor: str = Field(description="a sensor, as in the configuration", examples=["palm"])


class SeriesQuery(SensorQuery):
    """Which series."""

    method: schemas.MethodName | None = Field(None, description="left out: the one that is selected live")
    regions: str | None = Field(
        None,
        description="regions of the sensor, separated by commas; left out: all of them",
        examples=["heel,toe"],
    )
    format: Literal["json", "csv"] = Field("json", description="csv has every frame")


class Highest(schemas.Schema):
    """The highest value of a recording; null: not known."""

    value: float | None = Field(examples=[4.2])
    number: int = Field(description="of the first frame that has it, from 0", examples=[512])
    position_s: float = Field(description="from the recording's first message", examples=[5.12])


class AreaSeries(schemas.Schema):
    """Values of the array or a region; null: not known."""

    name: str = Field(description="of the region", examples=["heel"])
    force: list[float | None] = Field(description="in `force_unit`")
    mean: list[float | None] = Field(description="pressure, in `unit`")
    peak: list[float | None] = Field(description="pressure, in `unit`")
    area: list[float | None] = Field(description="mm2 in contact")
    highest: dict[Literal["force", "mean", "peak", "area"], Highest]


class PlayedSeries(schemas.Schema):
    """Values of every frame's restored image, in at most 600 pieces: of each piece the highest."""

    name: str = Field(examples=["grasp.log"])
    sensor: schemas.SensorName
    method: str = Field(description="by which every frame is restored", examples=["auto"])
    frames: int = Field(examples=[1025])
    measured: int = Field(description="frames by now", examples=[1025])
    running: bool = Field(description="whether frames are still being measured; values come at the end")
    error: str | None = Field(description="why it ended early", examples=[None])
    unit: schemas.Unit
    force_unit: ForceUnit = Field(examples=["N"])
    position_s: list[float] = Field([], description="at which each piece begins")
    total: AreaSeries | None = Field(None, description="of the whole array")
    regions: list[AreaSeries] = Field([], description="of each region")


def answer(
    runs: SeriesRuns, query: SeriesQuery, sensor: Sensor, recorded: RecordedFrames, playback: Playback
) -> Response:
    """A recording's series as far as it is measured; Problem where it cannot be measured now."""
    where = f"recording {recorded.path.name}"
    regions, method = _regions(sensor, query.regions), named(query.method or sensor.method)
    if recorded.reading:
        raise Problem(409, f"{where}: is not read to its end yet", SOON)
    try:
        run = runs.series(playback, recorded, method, regions)
    except OSError as error:
        raise Problem(503, f"{where}: {error.strerror}") from error
    if run is None:
        raise Problem(409, f"{where}: another series is being measured", SOON)
    running, measured = run.running, run.measured  # in this order
    if run.error:
        runs.drop(run)
    if query.format == "json":
        return _json(run, recorded, running, measured)
    if running or run.error:
        raise Problem(409, f"{where}: {measured} of {run.frames} frames are measured", SOON)
    file = f"{recorded.path.name.split('.')[0]}-{sensor.name}.csv"
    headers = {"Content-Disposition": f'attachment; filename="{file}"'}
    lines = _csv(run.job, recorded, run.rows.of_their_own())
    return StreamingResponse(lines, media_type=MEDIA["csv"], headers=headers)


def _regions(sensor: Sensor, names: str | None) -> dict[str, Region]:
    """The regions of these names, whose thresholds do not matter; Problem 404 names one that is not there."""
    each = sensor.regions.regions
    if names is not None:
        each = {name: watched(sensor, name).region for name in names.split(",") if name}
    return {name: region.model_copy(update={"threshold": None}) for name, region in each.items()}


def _json(run: RecordedSeries, recorded: RecordedFrames, running: bool, measured: int) -> Response:
    job, unit = run.job, run.job.plan.unit
    fields: dict[str, Any] = {
        "name": recorded.path.name, "sensor": job.plan.name, "method": job.method, "frames": run.frames,
        "measured": measured, "running": running, "unit": unit, "force_unit": FORCE_UNITS[unit],
        "error": without_path(run.error, recorded.path) or None,
    }  # fmt: skip
    if not running and not run.error:
        total, *regions = (_area(name, k, run.summary) for k, name in enumerate((TOTAL, *job.regions)))
        fields |= {"position_s": run.summary.position_s.tolist(), "total": total, "regions": regions}
    return Response(PlayedSeries(**fields).model_dump_json(), media_type=MEDIA["json"])


def _area(name: str, k: int, summary: Summary) -> AreaSeries:
    """The series of the array or the region of number `k`."""
    columns = dict(zip(Measures._fields, summary.values[:, k].T.tolist(), strict=True))
    highest = {
        key: Highest(
            value=float(summary.highest[k, n]),
            number=int(summary.number[k, n]),
            position_s=float(summary.highest_s[k, n]),
        )
        for n, key in enumerate(Measures._fields)
    }
    return AreaSeries(name=name, highest=highest, **columns)


def _csv(job: SeriesJob, recorded: RecordedFrames, rows: SeriesRows) -> Iterator[str]:
    """What they are of, then one line a frame; empty: not known."""
    with closing(rows.file):
        yield f"# recording: {recorded.path.name}\n# sensor: {job.plan.name}\n# method: {job.method}\n"
        yield f"# calibration: {job.plan.calibration_id}\n# position_s: from the recording's first message\n"
        areas, names = (TOTAL, *job.regions), headings(job.plan.unit)
        yield csv_lines(
            [["frame", "position_s", *(f"{area}_{each}" for area in areas for each in names), MISSING_TAXELS]]
        )
        for first in range(0, rows.frames, ROWS_AT_ONCE):
            some = rows.read(first, rows.frames)
            values = some["values"].reshape(len(some), -1).tolist()
            columns = zip(some["position"].tolist(), values, some["missing"].tolist(), strict=True)
            yield csv_lines(
                [n, f"{at:.6f}", *csv_table.values(row), missing]
                for n, (at, row, missing) in enumerate(columns, first)
            )
