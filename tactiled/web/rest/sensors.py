"""`/api/v1/health` and `/api/v1/sensors`: what sensors are and how they are doing; method, tare, contacts."""

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Request

from tactiled.calibrate.upkeep.drift import DriftState
from tactiled.calibrate.upkeep.health import RULES, Fault
from tactiled.cover.summary import summarise
from tactiled.errors import BusError
from tactiled.live.tare import TARE_FRAMES, TARE_S
from tactiled.restore.methods import METHODS, OLD_NAMES
from tactiled.web import answers, calibration_schemas, schemas
from tactiled.web.http.problems import SOON, Problem
from tactiled.web.rest import drawing
from tactiled.web.rest.dependencies import AnySensor, CurrentService, NamedSensor, keeping, no_frame
from tactiled.web.rest.openapi import CONTROL, JSON_BODY, problems
from tactiled.web.ws.push import as_array

router = APIRouter(prefix="/api/v1")


@router.get("/health", tags=["service"])
def health(service: CurrentService) -> schemas.Health:
    """Get the state of the service and of every sensor, the age of the last frame, and faults of parts."""
    sensors = {name: answers.sensor_state(sensor) for name, sensor in service.sensors.items()}
    live = all(each.state == "live" for each in sensors.values())
    faults = service.faults.now
    return schemas.Health(status="ok" if live and not faults else "degraded", sensors=sensors, faults=faults)


@router.get("/colormap", tags=["service"])
def colormap(
    name: Annotated[drawing.ColormapName, Query(description="Matplotlib's name of the colours")] = drawing.COLORS,
) -> schemas.Colormap:
    """Get the viewer's 256 colours; those of PNG images unless another `name` is given."""
    return schemas.Colormap(name=name, colors=drawing.colors(name))


@router.get("/sensors", tags=["sensors"])
def sensors(service: CurrentService) -> schemas.Sensors:
    """Get every sensor with its state, age, rate, method and loss counts."""
    return schemas.Sensors(sensors=tuple(map(answers.sensor_state, service.sensors.values())))


@router.get("/sensors/{name}", tags=["sensors"], responses=problems(404))
def sensor_state(sensor: AnySensor) -> schemas.SensorState:
    """Get one sensor with its state, age, rate, method and loss counts."""
    return answers.sensor_state(sensor)


@router.get("/sensors/{name}/geometry", tags=["sensors"], responses=problems(404))
def geometry(sensor: AnySensor) -> schemas.Geometry:
    """Get the positions of the taxels and the cells of the images, in mm."""
    return answers.geometry(sensor)


@router.get("/sensors/{name}/kernel", tags=["sensors"], responses=problems(404))
def kernel(sensor: NamedSensor) -> schemas.CoverKernel:
    """Get the cover's kernel g(r), its gain G(q), and the smallest resolvable gap."""
    kernel, summary = sensor.plan.kernel, summarise(sensor.plan.kernel, sensor.array)
    return schemas.CoverKernel(
        model=kernel.model,
        error_estimate=kernel.error_estimate,
        r_mm=kernel.r.tolist(),
        g_per_mm2=kernel.g.tolist(),
        q_per_mm=kernel.q.tolist(),
        gain=kernel.gain.tolist(),
        nyquist_per_mm=summary.nyquist,
        nyquist_gain=summary.nyquist_gain,
        smallest_gap_mm=summary.smallest_gap,
    )


@router.get("/sensors/{name}/method", tags=["sensors"], responses=problems(404))
def get_method(sensor: NamedSensor, service: CurrentService) -> schemas.Method:
    """Get the selected method, the configured one and the kept one."""
    after_restart = service.state.methods.get(sensor.name, "") if service.state else ""
    kept = OLD_NAMES.get(after_restart, after_restart)
    return schemas.Method(
        method=sensor.method, configured=sensor.plan.method, kept=kept if kept in METHODS else None
    )


@router.put("/sensors/{name}/method", tags=["sensors"], responses=problems(404, 409, 503, *CONTROL, *JSON_BODY))
def put_method(sensor: NamedSensor, service: CurrentService, selection: schemas.MethodSelection) -> schemas.Method:
    """Select a method: it applies from the next frame on, with `keep` also after a restart."""
    with keeping(service):
        service.set_method(sensor.name, selection.method, selection.keep)
    return get_method(sensor, service)


@router.get("/sensors/{name}/calibration", tags=["sensors"], responses=problems(404))
def calibration(sensor: NamedSensor, request: Request) -> calibration_schemas.SensorCalibration:
    """Get the present calibration from counts to pressure: as configured, with `no_load` from the last tare."""
    return answers.calibration(sensor, request.app.state.calibrations.way(sensor.name))


@router.post("/sensors/{name}/tare", tags=["sensors"], status_code=202, responses=problems(404, 409, *CONTROL))
def tare(
    sensor: NamedSensor,
    service: CurrentService,
    force: Annotated[bool, Query(description="tare even where the newest frames show a load")] = False,
) -> calibration_schemas.Tare:
    """Tare the sensor: the mean of the next 0.5 s, of 16 frames at least, becomes no load. An event reports it.

    It is refused or given up while a contact exceeds the noise or the readings move; `force=true` tares anyway.
    """
    service.tare(sensor.name, force)
    return calibration_schemas.Tare(frames=TARE_FRAMES, seconds=TARE_S)


@router.delete("/sensors/{name}/tare", tags=["sensors"], responses=problems(404, 409, *CONTROL))
def undo_tare(
    sensor: NamedSensor, service: CurrentService, request: Request
) -> calibration_schemas.SensorCalibration:
    """Undo the last tare: the no load from before it holds again. One that still collects frames is given up."""
    service.undo_tare(sensor.name)
    return answers.calibration(sensor, request.app.state.calibrations.way(sensor.name))


@router.get("/sensors/{name}/health", tags=["sensors"], responses=problems(404))
def taxel_health(sensor: NamedSensor) -> calibration_schemas.TaxelHealth:
    """Get taxels found not to work, noise and drift of every taxel, and creep of the load that lies now."""
    state, taxel_map = sensor.pipeline.monitor.state, sensor.pipeline.monitor.map
    faulty = [(int(at), Fault(state.faults[at])) for at in np.flatnonzero(state.faults)]
    counts = None if state.drift_states is None else np.bincount(state.drift_states, minlength=len(DriftState))
    return calibration_schemas.TaxelHealth(
        taxels=sensor.array.size,
        faults=[
            calibration_schemas.TaxelFault(
                taxel=at, fault=fault.name.lower(), reason=RULES[fault].reason, since=float(state.since_s[at])
            )
            for at, fault in faulty
        ],
        map=(", ".join(taxel_map.wrong) or "as configured") if taxel_map.judged else None,
        noise_counts=answers.numbers(state.noise_counts),
        drift_counts=None if state.drift_counts is None else answers.numbers(state.drift_counts),
        drift_states=None if counts is None else {each.name.lower(): int(counts[each]) for each in DriftState},
        creep=state.creep,
    )


@router.post(
    "/sensors/{name}/frames",
    tags=["frames"],
    status_code=202,
    responses=problems(404, 409, 503, *CONTROL, *JSON_BODY),
)
def push(sensor: NamedSensor, service: CurrentService, frame: schemas.PushedFrame) -> schemas.PushedNumber:
    """Push a frame into a sensor that is configured without `bus` and `codec`.

    For more than a few frames a second use `WS /api/v1/sensors/{name}/push`: here every frame counts as a change.
    """
    service.need_pushed(sensor.name)  # says so of any values
    try:
        number = service.push_frame(sensor.name, as_array(frame.values), frame.sequence, frame.time)
    except BusError as error:
        raise Problem(503, f"sensor {sensor.name!r}: {error}", SOON) from error
    return schemas.PushedNumber(sequence=number)


@router.get("/sensors/{name}/contacts", tags=["frames"], responses=problems(404, 503))
def contacts(sensor: AnySensor) -> schemas.Contacts:
    """Get the contacts: centre, force, area, peak, axes, and an id that stays while the contact lasts."""
    contacts = answers.contacts(sensor)
    if contacts is None:
        raise no_frame(sensor)
    return contacts
