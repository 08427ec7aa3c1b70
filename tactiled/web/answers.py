"""What the API says of images, sensors and the service: the forms, filled in."""

from dataclasses import asdict
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.error_frames import KINDS
from tactiled.cover.summary import summarise
from tactiled.frames import Image
from tactiled.restore.methods import METHODS
from tactiled.runtime.sensor import Sensor, Status
from tactiled.runtime.service import Service
from tactiled.web.schemas import (
    DECIMALS,
    CalibrationForm,
    ContactForm,
    Contacts,
    Frame,
    Geometry,
    Health,
    ImageShape,
    KernelForm,
    Loss,
    Method,
    SensorState,
    Shown,
    StreamStatus,
)


def loss(status: Status) -> Loss:
    """Counts of a status."""
    counts = status.loss
    return Loss(
        lost=counts.lost,
        repeated=counts.repeated,
        late=counts.late,
        foreign=counts.foreign,
        malformed=counts.malformed,
        incomplete=counts.incomplete,
        skipped=counts.skipped,
        dropped=counts.dropped,
        errors=counts.errors,
        bus_off=counts.bus_off,
        unsent=counts.unsent,
        unreadable=counts.unreadable,
    )


def sensor_state(sensor: Sensor) -> SensorState:
    """A sensor as it is now."""
    status, image, shape = sensor.status(), sensor.hub.latest(), sensor.array.shape
    return SensorState(
        name=sensor.name,
        bus=sensor.plan.bus,
        codec=sensor.plan.codec_name,
        rows=shape[0] if shape else None,
        columns=shape[1] if shape else None,
        taxels=sensor.array.size,
        pitch_mm=sensor.array.pitch,
        shear=sensor.plan.shears,
        method=sensor.method,
        methods=tuple(METHODS),
        state=status.state,
        age_s=status.age_s,
        rate_hz=status.rate_hz,
        jitter_s=status.jitter_s,
        clock=sensor.clock,
        skew_s=status.skew_s,
        detail=status.detail,
        sequence=image.sequence if image else None,
        loss=loss(status),
        error_kinds={kind: status.errors.get(kind, 0) for kind in KINDS},
    )


def health(service: Service) -> Health:
    """The service as it is now."""
    sensors = {name: sensor_state(sensor) for name, sensor in service.sensors.items()}
    live = all(each.state == "live" for each in sensors.values())
    faults = service.faults.now
    return Health(status="ok" if live and not faults else "degraded", sensors=sensors, faults=faults)


def numbers(values: NDArray[np.float32]) -> list[list[float | None]] | list[float | None]:
    """Round to DECIMALS; null for what JSON has no number for."""
    rounded = np.round(values.astype(float), DECIMALS).astype(object)
    rounded[~np.isfinite(values)] = None
    listed: list[list[float | None]] = rounded.tolist()
    return listed


def npy(values: NDArray[np.float32]) -> bytes:
    """Give an array as a .npy file."""
    out = BytesIO()
    np.save(out, values)
    return out.getvalue()


def values(sensor: Sensor, image: Image, kind: Shown) -> NDArray[np.float32]:
    """What is shown of an image, kPa."""
    if kind == "deviation":
        return sensor.pipeline.deviation(image)
    return image.raw if kind == "raw" else image.restored


def frame(sensor: Sensor, image: Image, kind: Shown) -> Frame:
    """One image, with the sensor's present state."""
    status = sensor.status()
    return Frame(
        sensor=image.sensor,
        kind=kind,
        sequence=image.sequence,
        timestamp=image.time,
        state=status.state,
        age_s=status.age_s,
        values=numbers(values(sensor, image, kind)),
        flags=image.flags.tolist(),
        method=image.method,
        why=image.why,
        iterations=image.iterations,
        microseconds=image.microseconds,
        noise_kpa=image.noise_kpa,
        noise_gain=image.noise_gain,
        resolution_mm=image.resolution_mm,
        loss=loss(status),
        warnings=image.warnings,
    )


def contacts(sensor: Sensor) -> Contacts | None:
    """Where something touches now; None before the first frame."""
    image, found = sensor.contacts()
    if image is None:
        return None
    return Contacts(
        sensor=sensor.name,
        sequence=image.sequence,
        timestamp=image.time,
        state=sensor.status().state,
        contacts=tuple(ContactForm(**asdict(each)) for each in found),
    )


def stream_status(sensor: Sensor, image: Image | None, status: Status) -> StreamStatus:
    """A sensor's state and how its newest image was made."""
    made = (
        {}
        if image is None
        else {
            "sequence": image.sequence,
            "timestamp": image.time,
            "ran": image.method,
            "why": image.why,
            "iterations": image.iterations,
            "microseconds": image.microseconds,
            "noise_kpa": image.noise_kpa,
            "noise_gain": image.noise_gain,
            "resolution_mm": image.resolution_mm,
            "warnings": image.warnings,
        }
    )
    return StreamStatus.model_validate(
        {
            "sensor": sensor.name,
            "state": status.state,
            "age_s": status.age_s,
            "rate_hz": status.rate_hz,
            "jitter_s": status.jitter_s,
            "skew_s": status.skew_s,
            "detail": status.detail,
            "loss": loss(status),
            "method": sensor.method,
            **made,
        }
    )


def kernel(sensor: Sensor) -> KernelForm:
    """A sensor's cover."""
    solved, told = sensor.plan.kernel, summarise(sensor.plan.kernel, sensor.array)
    return KernelForm(
        model=solved.model,
        error_estimate=solved.error_estimate,
        r_mm=solved.r.tolist(),
        g_per_mm2=solved.g.tolist(),
        q_per_mm=solved.q.tolist(),
        gain=solved.gain.tolist(),
        nyquist_per_mm=told.nyquist,
        nyquist_gain=told.nyquist_gain,
        smallest_gap_mm=told.smallest_gap if np.isfinite(told.smallest_gap) else None,
    )


def geometry(sensor: Sensor) -> Geometry:
    """Where a sensor's taxels and surface cells are."""
    array = sensor.array
    rows, columns = array.shape or (1, array.size)
    cell_mm = sensor.plan.cell_mm
    refine = round(array.pitch / cell_mm) if array.shape else 1
    return Geometry(
        shape=list(array.shape) if array.shape else None,
        positions_mm=array.positions.tolist(),
        pitch_mm=array.pitch,
        aperture=array.aperture,
        aperture_mm=array.width,
        raw=ImageShape(rows=rows, columns=columns, cell_mm=array.pitch),
        restored=ImageShape(rows=rows * refine, columns=columns * refine, cell_mm=cell_mm),
        areas_mm2=None if array.shape else sensor.plan.cells.areas.tolist(),
    )


def method(service: Service, sensor: Sensor) -> Method:
    """How a sensor's frames are restored, and would be after a restart."""
    kept = service.state.methods.get(sensor.name) if service.state else None
    return Method(method=sensor.method, configured=sensor.plan.method, kept=kept if kept in METHODS else None)


def calibration(sensor: Sensor) -> CalibrationForm:
    """A sensor's calibration as it is now."""
    configured = sensor.plan.calibration
    return CalibrationForm(
        calibrated=all(each.code != "uncalibrated" for each in sensor.plan.warnings),
        kpa_per_count=configured.kpa_per_count,
        no_load=sensor.pipeline.no_load.tolist(),
        tared=sensor.pipeline.tared,
        saturation=configured.saturation,
        noise_kpa=sensor.pipeline.noise_kpa,
        dead=list(configured.dead),
        shear_n_per_count=configured.shear_n_per_count,
    )
