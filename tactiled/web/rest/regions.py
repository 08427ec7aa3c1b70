"""`/api/v1/sensors/{name}/regions`: parts of an array that somebody watches, and their values over time."""

import csv
import io
from collections.abc import Iterable
from dataclasses import asdict
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response
from pydantic import Field

from tactiled import units
from tactiled.archive import csv_table
from tactiled.bounds import Syntax
from tactiled.contacts.regions import Measures, Region, headings
from tactiled.live import region_monitor
from tactiled.live.region_monitor import SERIES_S, RegionSeries
from tactiled.live.sensor import Sensor
from tactiled.live.status import State
from tactiled.web import schemas
from tactiled.web.http.problems import Problem
from tactiled.web.rest.dependencies import CurrentService, NamedSensor, keeping
from tactiled.web.rest.openapi import CONTROL, JSON_BODY, problems, success

MAX_POINTS = 60_000
MISSING_TAXELS = "missing_taxels"  # heading of the taxels that did not arrive, of the array
NAME = Syntax(r"^[\w][\w .-]{0,39}$", "1 to 40 letters, digits, _ . - or spaces, a letter, digit or _ first")
RegionName = Annotated[str, NAME, Path(description="a region of the sensor", examples=["heel"])]
router = APIRouter(prefix="/api/v1/sensors/{name}/regions", tags=["regions"])


class RegionMeasures(schemas.Schema):
    """What a region holds; null: not known."""

    force: float | None = Field(examples=[4.2], description="N, or counts mm2")
    mean: float | None = Field(examples=[31.0], description="pressure, in `unit`")
    peak: float | None = Field(examples=[98.5], description="pressure, in `unit`")
    area: float | None = Field(examples=[64.0], description="mm2 in contact")


class WatchedRegion(Region):
    """A region and what it holds and has held."""

    name: str = Field(examples=["heel"])
    unit: units.Unit = Field("kPa", description="of pressures")
    now: RegionMeasures | None = Field(
        None, description="in the newest image; null before the first, and where the sensor is not live"
    )
    highest: RegionMeasures | None = Field(None, description="each on its own, since `since`")
    impulse: float = Field(0.0, description="integral of force over time since `since`, N s or counts mm2 s")
    pressure_time: float = Field(0.0, description="integral of the peak pressure since `since`, `unit` times s")
    since: float | None = Field(None, description="Unix time of the first image, or of the first after a reset")
    exceeded: bool = Field(False, description="the threshold is, in the newest image")

    @classmethod
    def of(cls, series: RegionSeries, state: State) -> "WatchedRegion":
        """As it is now, by the state of its sensor."""
        summary = series.summary()
        held = asdict(summary) | ({} if state == "live" else {"now": None}) if summary else {}
        return cls(name=series.name, **dict(series.region), **held)


class WatchedRegions(schemas.Schema):
    """The regions of a sensor."""

    regions: tuple[WatchedRegion, ...]
    state: State = Field(description="of the sensor", examples=["live"])
    timestamp: float | None = Field(
        description="Unix time of the newest image; null before the first", examples=[1763712000.25]
    )
    kept: bool = Field(description="they are there after a restart, too")


class KeptSeries(schemas.Schema):
    """Values of a region, image by image; null: not known."""

    unit: units.Unit
    time: list[float] = Field(description="s, Unix", examples=[[1763712000.25]])
    force: list[float | None] = Field(examples=[[4.2]])
    mean: list[float | None] = Field(examples=[[31.0]])
    peak: list[float | None] = Field(examples=[[98.5]])
    area: list[float | None] = Field(examples=[[64.0]])
    missing: list[int] = Field([], description="taxels of the array that did not arrive", examples=[[0]])


def watched(sensor: Sensor, region: str) -> RegionSeries:
    """A region of a sensor; Problem 404 where it has none of that name."""
    try:
        return sensor.regions.series[region]
    except KeyError as error:
        names = ", ".join(sensor.regions.series) or "none"
        raise Problem(404, f"sensor {sensor.name!r} has no region {region!r}; there are: {names}") from error


@router.get("", responses=problems(404))
def regions(sensor: NamedSensor, service: CurrentService) -> WatchedRegions:
    """Get the regions with their values now, their highest values and integrals."""
    state, image = sensor.state, sensor.hub.latest()
    each = tuple(WatchedRegion.of(series, state) for series in sensor.regions.series.values())
    timestamp = None if image is None else image.time
    return WatchedRegions(regions=each, state=state, timestamp=timestamp, kept=service.state is not None)


@router.put("/{region}", responses=problems(404, 409, 503, *CONTROL, *JSON_BODY))
def put_region(sensor: NamedSensor, service: CurrentService, region: RegionName, body: Region) -> WatchedRegion:
    """Watch a region, or replace one; it is there after a restart, too, if the service keeps a state."""
    try:
        with keeping(service):
            service.regions.put(sensor, region, body)
    except ValueError as error:
        raise Problem(409, str(error)) from error
    return WatchedRegion.of(watched(sensor, region), sensor.state)


@router.delete("/{region}", status_code=204, responses=problems(404, 503, *CONTROL))
def remove_region(sensor: NamedSensor, service: CurrentService, region: RegionName) -> None:
    """Watch a region no longer."""
    watched(sensor, region)
    with keeping(service):
        service.regions.remove(sensor, region)


@router.post("/{region}/reset", status_code=204, responses=problems(404, *CONTROL))
def reset_region(sensor: NamedSensor, region: RegionName) -> None:
    """Forget the highest values and the integrals of a region."""
    watched(sensor, region).reset()


@router.get(
    "/{region}/series", response_model=KeptSeries, responses=problems(404) | success("one line an image", "csv")
)
def series(
    sensor: NamedSensor,
    region: RegionName,
    seconds: Annotated[float, Query(gt=0, le=SERIES_S, description="before the newest image")] = 60.0,
    until: Annotated[
        float | None, Query(allow_inf_nan=False, description="`timestamp` of the image that counts as the newest")
    ] = None,
    points: Annotated[
        int, Query(ge=2, le=MAX_POINTS, description="at most; of more images the ones of highest peak")
    ] = MAX_POINTS,
    form: Annotated[
        Literal["json", "csv"], Query(alias="format", description="a CSV has a line an image")
    ] = "json",
) -> Response:
    """Get force, mean, peak and contact area of a region, image by image."""
    kept = watched(sensor, region).series(seconds, points, until)
    if form == "csv":
        head = f"# sensor: {sensor.name}\n# region: {region}\n# time_s: Unix time\n"
        headers = {"Content-Disposition": f'attachment; filename="{sensor.name}-{region}.csv"'}
        return Response(head + _csv(kept), media_type="text/csv", headers=headers)
    columns = dict(zip(Measures._fields, kept.values.T.tolist(), strict=True))
    lists = {"time": kept.time.tolist(), "missing": kept.missing.tolist()}
    content = KeptSeries(unit=kept.unit, **lists, **columns).model_dump_json()
    return Response(content, media_type="application/json")


def _csv(series: region_monitor.Series) -> str:
    """One line an image; empty: not known."""
    rows = ([f"{at:.6f}", *csv_table.values(row), missing] for at, row, missing in zip(*series[:3], strict=True))
    return csv_lines([["time_s", *headings(series.unit), MISSING_TAXELS], *rows])


def csv_lines(rows: Iterable[list[Any]]) -> str:
    """Lines of a CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
