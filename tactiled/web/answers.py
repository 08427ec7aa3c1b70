"""What the API answers on images, sensors and the service: the schemas, filled in."""

from collections.abc import Iterable
from dataclasses import asdict, replace
from io import BytesIO
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.socketcan import KINDS
from tactiled.contacts.detection import DetectedContact
from tactiled.frames import SensorImage
from tactiled.live.sensor import Sensor
from tactiled.live.status import Status
from tactiled.restore.methods import METHODS
from tactiled.units import FORCE_UNITS, Unit, if_calibrated
from tactiled.web import calibration_schemas, schemas
from tactiled.web.schemas import PressureKind
from tactiled.web.views import SensorView
from tactiled.wire import values_of

DECIMALS = 4  # of a pressure in JSON: 0.1 Pa


def sensor_state(sensor: SensorView) -> schemas.SensorState:
    """A sensor as it is now."""
    status, image = sensor.status(), sensor.hub.latest()
    rows, columns = sensor.array.shape or (None, None)
    return schemas.SensorState(
        **schemas.Status.shared(status),
        name=sensor.name,
        bus=sensor.plan.bus,
        codec=sensor.plan.codec_name,
        rows=rows,
        columns=columns,
        taxels=sensor.array.size,
        pitch_mm=sensor.array.pitch,
        shear=sensor.plan.shears,
        traction=sensor.plan.restores_shear,
        unit=sensor.plan.unit,
        method=sensor.method,
        methods=tuple(METHODS),
        clock=sensor.clock,
        sequence=image.sequence if image else None,
        references=sensor.references,
        error_kinds={kind: status.errors.get(kind, 0) for kind in KINDS},
    )


def numbers(values: NDArray[np.floating]) -> Any:
    """A list, or lists, of numbers rounded to DECIMALS; NaN becomes null in JSON."""
    return np.round(values.astype(float), DECIMALS).tolist()


def npy(values: NDArray[np.float32]) -> bytes:
    """Give an array as a .npy file."""
    out = BytesIO()
    np.save(out, values)
    return out.getvalue()


def pressures(
    sensor: SensorView, image: SensorImage, kind: PressureKind, cells: schemas.ImageCells = "raster"
) -> NDArray[np.float32]:
    """An image of this kind, in its unit."""
    if kind == "raw":
        return image.raw
    values = sensor.deviation(image) if kind == "deviation" else image.restored
    return values if cells == "raster" else by_taxel(sensor, values)


def by_taxel(sensor: SensorView, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean of restored images (..., R, C) on each taxel, (..., *raw image)."""
    means = sensor.cells.at_taxels(values, sensor.array.size)
    return means.reshape(*values.shape[:-2], *sensor.array.frame_shape)


def on_taxels(sensor: SensorView, image: SensorImage) -> SensorImage:
    """An image with the means of what is restored on each taxel."""
    names = ("restored", "traction", "traction_deviation")
    known = {name: each for name in names if (each := getattr(image, name)) is not None}
    means: dict[str, Any] = {name: by_taxel(sensor, each) for name, each in known.items()}
    return replace(image, **means)


def _message(image: SensorImage, status: Status) -> dict[str, Any]:
    """The fields that every message on an image has."""
    return {"sensor": image.sensor, "state": status.state, "sequence": image.sequence, "timestamp": image.time}


def _restoration(image: SensorImage) -> dict[str, Any]:
    """How an image was made."""
    return schemas.Restoration.shared(image) | {"noise_kpa": if_calibrated(image.noise, image.unit)}


def frame(
    sensor: SensorView, image: SensorImage, kind: PressureKind, cells: schemas.ImageCells = "raster"
) -> schemas.Frame:
    """One image, with the sensor's present state."""
    status = sensor.status()
    return schemas.Frame(
        **_message(image, status),
        **_restoration(image),
        kind=kind,
        age_s=status.age_s,
        values=numbers(pressures(sensor, image, kind, cells)),
        flags=image.flags.tolist(),
        method=image.method,
        loss=status.loss,
        warnings=image.warnings,
    )


def surface(sensor: Sensor, image: SensorImage) -> schemas.Surface:
    """The newest image with what lies beyond the taxels, with the sensor's present state."""
    cells, wide = sensor.cells, sensor.plan.blur.wide
    rows, columns = wide.own if wide else (slice(0, n) for n in cells.shape)
    values, deviation = (numbers(each) for each in sensor.surface(image))
    return schemas.Surface(
        **_message(image, sensor.status()),
        unit=image.unit,
        cell_mm=cells.side,
        origin_mm=(cells.corner - cells.side * np.array([columns.start, rows.start])).tolist(),
        own=[rows.start, rows.stop, columns.start, columns.stop],
        values=values,
        deviation=deviation,
    )


def shear(sensor: SensorView, image: SensorImage) -> schemas.Shear:
    """Shear of an image that has it, with the sensor's present state."""
    x, y = (numbers(each) for each in np.asarray(image.shear))
    return schemas.Shear(**_message(image, sensor.status()), x=x, y=y)


def traction(sensor: SensorView, image: SensorImage) -> schemas.Traction:
    """Restored shear of an image, null where there is none yet, with the sensor's present state."""
    load = values_of(image, "traction")
    spread = np.full_like(load, np.nan) if image.traction_deviation is None else image.traction_deviation
    (x, y), (x_deviation, y_deviation) = (map(numbers, each) for each in (load, spread))
    deviations = {"x_deviation": x_deviation, "y_deviation": y_deviation}
    return schemas.Traction(**_message(image, sensor.status()), x=x, y=y, **deviations)


def contacts(sensor: SensorView) -> schemas.Contacts | None:
    """Where something touches now; None before the first frame."""
    image, contacts = sensor.contacts()
    if image is None:
        return None
    return schemas.Contacts(
        **_message(image, sensor.status()),
        unit=image.unit,
        force_unit=FORCE_UNITS[image.unit],
        unknown_cells=int(np.count_nonzero(np.isnan(image.restored) & sensor.cells.felt)),
        contacts=listed(contacts, image.unit),
    )


def listed(contacts: Iterable[DetectedContact], unit: Unit) -> list[dict[str, Any]]:
    """The fields of contacts in an image whose pressure has this unit."""
    return [
        asdict(each)
        | {"force_n": if_calibrated(each.force, unit), "peak_kpa": if_calibrated(each.peak, unit)}
        | {"force_deviation": None if isnan(each.force_deviation) else each.force_deviation}
        for each in contacts
    ]


def stream_status(sensor: SensorView, image: SensorImage | None, status: Status) -> schemas.StreamStatus:
    """A sensor's state and how its newest image was made."""
    fields = schemas.Status.shared(status) | {
        "sensor": sensor.name,
        "method": sensor.method,
        "unit": sensor.plan.unit,
    }
    if image is not None:
        fields |= _message(image, status) | _restoration(image)
        fields |= {"ran": image.method, "warnings": image.warnings}
    return schemas.StreamStatus(**fields)


def geometry(sensor: SensorView) -> schemas.Geometry:
    """Where a sensor's taxels and surface cells are."""
    array, cells = sensor.array, sensor.cells
    rows, columns = array.shape or (1, array.size)
    areas = sensor.areas_mm2
    return schemas.Geometry(
        shape=list(array.shape) if array.shape else None,
        positions_mm=array.positions.tolist(),
        pitch_mm=array.pitch,
        aperture=array.aperture,
        aperture_mm=array.width,
        raw=schemas.ImageShape(rows=rows, columns=columns, cell_mm=array.pitch),
        restored=schemas.RestoredShape(
            rows=cells.shape[0],
            columns=cells.shape[1],
            cell_mm=cells.side,
            origin_mm=(float(cells.corner[0]), float(cells.corner[1])),
            mask=None if cells.felt.all() else cells.felt.tolist(),
        ),
        areas_mm2=None if areas is None else list(areas),
    )


def calibration(sensor: Sensor, session: str | None) -> calibration_schemas.SensorCalibration:
    """A sensor's calibration as it is now; `session` is the way of an open guided one."""
    plan, noise = sensor.plan, sensor.pipeline.noise.kpa
    gain = plan.calibration.kpa_per_count
    return calibration_schemas.SensorCalibration(
        **calibration_schemas.SensorCalibration.shared(plan.calibration)
        | {
            "calibrated": plan.calibrated,
            "no_load": sensor.pipeline.calibrator.no_load.tolist(),
            "tared": sensor.pipeline.tares.done,
            "load": sensor.pipeline.load_description(),
            "session": session,
            "tared_at": sensor.pipeline.zero.time,
            "can_undo": sensor.pipeline.can_undo,
            "id": plan.calibration_id,
            "created": plan.file.created if plan.file else None,
            "sections": {name: each.origin for name, each in plan.file.sections.items()} if plan.file else {},
            "unit": plan.unit,
            "gain": gain,
            "kpa_per_count": if_calibrated(gain, plan.unit),
            "noise": noise,
            "noise_kpa": if_calibrated(noise, plan.unit),
        }
    )
