"""`/api/v1/sensors/{name}/calibration/session`: a guided calibration, as the viewer's page does it."""

from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Request
from pydantic import Discriminator, Field, Tag

from tactiled.calibrate.cover.fit import MAX_EDGE_MM, MAX_TIP_MM, MIN_SIZE_MM
from tactiled.errors import CalibrationStateError
from tactiled.guided import session as calibration_session
from tactiled.guided.calibrations import GuidedCalibrations, Session
from tactiled.guided.cover_procedure import CoverOutcome
from tactiled.guided.gain_procedure import GainOutcome
from tactiled.guided.session import Way
from tactiled.web import schemas
from tactiled.web.rest.dependencies import CurrentService, NamedSensor, applying
from tactiled.web.rest.openapi import CONTROL, JSON_BODY, problems

MAX_LINE_POINTS = 400  # of a plotted line: it is part of every answer
Numbers = Annotated[list[float | None], Field(examples=[[0.0, 0.4, 1.0]])]
Interval = Annotated[tuple[float, float], Field(description="95 %")]


class StartTip(schemas.RequestBody):
    """Calibrate the cover with a tip."""

    way: Literal["tip"]
    tip_mm: float | None = Field(
        None,
        ge=MIN_SIZE_MM,
        le=MAX_TIP_MM,
        description="diameter of its flat end; left out: it is fitted",
        examples=[2.0],
    )


class StartEdge(schemas.RequestBody):
    """Calibrate the cover with a straight edge or ridge."""

    way: Literal["edge"]
    edge_mm: float | None = Field(
        None,
        ge=MIN_SIZE_MM,
        le=MAX_EDGE_MM,
        description="width of the ridge; left out: a pad with one edge",
        examples=[1.2],
    )


class StartOther(schemas.RequestBody):
    """Calibrate in another way."""

    way: Literal["uniform", "weight", "blind"] = Field(
        description="of the gain: uniform (pressure), weight; of the cover: blind (any contact)",
        examples=["uniform"],
    )


class PressureMark(schemas.RequestBody):
    """The pressure that the array is under now, of way uniform."""

    pressure_kpa: float = Field(ge=0, le=1e5, allow_inf_nan=False, examples=[20.0])


class WeightMark(schemas.RequestBody):
    """The weight that lies on the array now, of way weight."""

    weight_n: float = Field(ge=0, le=1e5, allow_inf_nan=False, examples=[9.81])


Start = Annotated[StartTip | StartEdge | StartOther, Field(discriminator="way")]
Mark = Annotated[
    Annotated[PressureMark, Tag("uniform")] | Annotated[WeightMark, Tag("weight")],
    Discriminator(lambda body: "weight" if isinstance(body, dict) and "weight_n" in body else "uniform"),
]


class Quality(schemas.Schema):
    """What the frames so far are good for."""

    advice: str = Field(examples=["12 of 20 presses; enough in the middle, none at the left border"])
    enough: bool
    presses: int = Field(description="presses, edges, steps, or seconds of contact", examples=[12])
    presses_needed: int = Field(examples=[20])
    presses_saturated: int = Field(description="not used: their pressure is unknown", examples=[0])
    last_unused: str = Field(description='why the last press is not used; "": it is', examples=[""])
    zones: tuple[tuple[int, ...], ...] = Field(
        description="presses in 3 x 3 zones of the array; empty where places do not matter",
        examples=[[[1, 2, 0], [0, 5, 1], [1, 1, 1]]],
    )
    zone_presses_needed: int = Field(examples=[2])


class GainLine(schemas.Schema):
    """Pressure over counts of the median taxel."""

    counts: Numbers = Field(description="over no load")
    measured_kpa: Numbers
    fitted_kpa: Numbers


class GainResult(schemas.Schema):
    """Fitted gains, and the ones before."""

    form: str = Field(description="of the curves: linear, power, cubic or spline", examples=["linear"])
    kpa_per_count: float = Field(description="median over the taxels", examples=[0.051])
    interval_kpa_per_count: Interval | None = Field(
        description="null: unknown, of a weight laid at one place", examples=[[0.0505, 0.0515]]
    )
    before_kpa_per_count: float | None = Field(description="null: counts had no scale", examples=[0.05])
    spread_percent: float | None = Field(
        description="standard deviation over the taxels; null: unknown", examples=[18.0]
    )
    hysteresis_percent: float | None = Field(description="of full scale; null: unknown", examples=[2.1])
    notes: tuple[str, ...]
    line: GainLine


class CoverLine(schemas.Schema):
    """Response along a line through a press, over its peak."""

    x_mm: Numbers
    measured: Numbers
    fitted: Numbers


class CoverResult(schemas.Schema):
    """Fitted thickness of the cover, and the one before."""

    thickness_mm: float = Field(examples=[1.18])
    interval_mm: Interval = Field(examples=[[1.15, 1.21]])
    before_mm: float = Field(examples=[1.2])
    presses: int = Field(description="presses, edges or frames that were used", examples=[20])
    residual: float | None = Field(
        description="root mean square of presses left out of the fit, over the noise; null: unknown",
        examples=[1.1],
    )
    reason: str = Field(description='why the presses cannot tell the thickness; "": they can', examples=[""])
    notes: tuple[str, ...] = Field(description="what they cannot tell, and what was not used")
    line: CoverLine | None


class CalibrationSession(schemas.Schema):
    """A guided calibration as it is now."""

    sensor: schemas.SensorName
    way: Way
    size_mm: float | None = Field(description="tip_mm or edge_mm of the start", examples=[2.0])
    state: calibration_session.SessionState = Field(description="collecting frames, fitting them, or fitted")
    frames: int = Field(examples=[4200])
    seconds: float = Field(description="of frames so far", examples=[42.0])
    seconds_limit: float = Field(examples=[120.0])
    full: bool = Field(description="no more frames are collected")
    load: str = Field(description='load that the newest frames show, "" for none', examples=["contact of 12 kPa"])
    quality: Quality
    error: str = Field(description="why the last fit failed", examples=[""])
    gain: GainResult | None
    cover: CoverResult | None


def _gain(outcome: GainOutcome) -> GainResult:
    counts, measured, fitted = outcome.line.tolist()
    line = GainLine(counts=counts, measured_kpa=measured, fitted_kpa=fitted)
    return GainResult(**GainResult.shared(outcome) | {"line": line})


def _cover(outcome: CoverOutcome) -> CoverResult:
    fit = outcome.fit
    line = None
    if fit.line is not None:
        every = -(-fit.line.shape[1] // MAX_LINE_POINTS)
        x, measured, fitted = fit.line[:, ::every].tolist()
        line = CoverLine(x_mm=x, measured=measured, fitted=fitted)
    return CoverResult(**CoverResult.shared(fit) | {"line": line, "before_mm": outcome.before_mm})


def _answer(session: Session) -> CalibrationSession:
    """A session as it is now."""
    collector, procedure, outcome = session.collector, session.procedure, session.outcome
    return CalibrationSession(
        sensor=session.sensor.name,
        way=procedure.way,
        size_mm=procedure.size_mm,
        state=session.state,
        frames=len(collector),
        seconds=collector.seconds,
        seconds_limit=collector.max_s,
        full=collector.full,
        load=session.sensor.pipeline.load_description(),
        quality=session.quality(),
        error=session.error,
        gain=_gain(outcome) if isinstance(outcome, GainOutcome) else None,
        cover=_cover(outcome) if isinstance(outcome, CoverOutcome) else None,
    )


async def _calibrations(request: Request) -> GuidedCalibrations:
    calibrations: GuidedCalibrations = request.app.state.calibrations
    return calibrations


Calibrations = Annotated[GuidedCalibrations, Depends(_calibrations)]
PATH = "/api/v1/sensors/{name}/calibration/session"
router = APIRouter(prefix=PATH, tags=["calibration"], responses=problems(404))


@router.post("", status_code=201, responses=problems(409, *CONTROL, *JSON_BODY))
def start(calibrations: Calibrations, sensor: NamedSensor, what: Start) -> CalibrationSession:
    """Start a guided calibration: frames are collected from now on. It ends after 300 s without a request."""
    size_mm = getattr(what, "tip_mm", None) or getattr(what, "edge_mm", None)
    return _answer(calibrations.start(sensor.name, what.way, size_mm))


@router.get("")
def state(calibrations: Calibrations, sensor: NamedSensor) -> CalibrationSession:
    """Get the open calibration: what was collected, its quality, and the result of the fit."""
    return _answer(calibrations.session(sensor.name))


@router.post("/mark", responses=problems(409, *CONTROL, *JSON_BODY))
def mark(calibrations: Calibrations, sensor: NamedSensor, what: Mark) -> CalibrationSession:
    """Take the newest frames, 2 s of them at most, as those under this load; 0 comes first."""
    session = calibrations.session(sensor.name)
    ((key, value),) = what.model_dump().items()
    procedure = session.procedure
    if key != procedure.mark_key:
        needed = f"give {procedure.mark_key}" if procedure.mark_key else "it needs none"
        raise CalibrationStateError(f"{key} = {value:g}: the calibration is by way {procedure.way!r}: {needed}")
    session.mark(value)
    return _answer(session)


@router.post("/fit", status_code=202, responses=problems(409, *CONTROL))
def fit(calibrations: Calibrations, sensor: NamedSensor) -> CalibrationSession:
    """Start the fit, which takes seconds; `state` is fitted when it is done."""
    session = calibrations.session(sensor.name)
    session.fit()
    return _answer(session)


@router.post("/cancel", responses=problems(409, *CONTROL))
def cancel(calibrations: Calibrations, sensor: NamedSensor) -> CalibrationSession:
    """Stop the fit and collect on."""
    session = calibrations.session(sensor.name)
    session.cancel()
    return _answer(session)


@router.post("/apply", status_code=204, responses=problems(409, 503, *CONTROL))
def apply(calibrations: Calibrations, sensor: NamedSensor, service: CurrentService) -> None:
    """Apply the result from the next frame on; the session ends."""
    with applying(service, sensor.name):
        calibrations.apply(sensor.name)


@router.delete("", status_code=204, responses=problems(*CONTROL))
def discard(calibrations: Calibrations, sensor: NamedSensor) -> None:
    """End the session without a change."""
    calibrations.discard(sensor.name)
