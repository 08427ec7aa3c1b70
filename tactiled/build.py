"""The composition root: from a checked configuration to arrays, stacks, codecs and plans."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from time import monotonic

import numpy as np

from tactiled import surface
from tactiled.arrays import Floats
from tactiled.bus import skins
from tactiled.bus.codec import Codec, ShearCodec
from tactiled.bus.codecs.packed import CLASSIC
from tactiled.bus.router import Router
from tactiled.calibrate import calibration_file
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.sections import CoverSection
from tactiled.config import classic, schema
from tactiled.cover.cache import Report
from tactiled.cover.kernel import Kernel, cached, radial
from tactiled.cover.stack import Layer, Stack
from tactiled.cover.summary import CoverSummary, summarise
from tactiled.diagnostics.warning_codes import warning
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import CONFIGURED, FrameWarning
from tactiled.geometry import Array, Pose, Raster, grid, layout, raster, tiling
from tactiled.restore.blur import Blur
from tactiled.restore.methods import named
from tactiled.restore.traction import Coupled
from tactiled.units import COUNTS, N_PER_KPA_MM2, PRESSURE, Unit

LOG = logging.getLogger(__name__)
MAX_CELLS = 1 << 16  # of a surface: four times the taxels that the packed layout can carry, and solved in seconds
MAX_CELLS_IN_A_ROW = 1024  # as many as an array may have taxels in a row
THICK_FROM_PITCHES = 2.0  # a smallest gap above this comes from the cover


@dataclass(frozen=True, slots=True, eq=False)
class SensorPlan:
    """Everything one sensor is made with, its kernel solved."""

    name: str
    bus: str
    codec_name: str
    codec: Codec
    array: Array
    kernel: Kernel
    blur: Blur
    cells: Raster  # of the restored image
    calibration: Calibration
    method: str
    budget_s: float | None  # for restoring a frame; None for the default
    stale_after_s: float
    warnings: tuple[FrameWarning, ...]  # that hold for every image
    calibrated: bool  # whether pressures are in kPa; else they are in counts
    file: CalibrationFile | None = None  # that it is calibrated with
    pose: Pose | None = None  # of the array in its robot; None where it is not configured
    coupled: Coupled | None = None  # what it feels of a tangential load; None where that is not restored

    @property
    def unit(self) -> Unit:
        """Of its pressures."""
        return PRESSURE if self.calibrated else COUNTS

    @property
    def calibration_id(self) -> str:
        """Id of the calibration file, or `configured`."""
        return self.file.id if self.file else CONFIGURED

    @property
    def no_load_time(self) -> float:
        """When the calibration file's no load was measured, s, Unix; -inf where it has none."""
        return self.file.no_load.origin.time if self.file and self.file.no_load else -np.inf

    @property
    def shears(self) -> bool:
        """Whether the skin feels shear."""
        return isinstance(self.codec, ShearCodec)

    @property
    def restores_shear(self) -> bool:
        """Whether shear has a scale, and the cover holds a tangential load."""
        return self.coupled is not None

    @property
    def kpa_per_shear_count(self) -> Floats:
        """(N,) tangential stress of one count of shear; of a skin whose tangential load is restored."""
        assert self.calibration.shear_n_per_count is not None
        return self.calibration.shear_n_per_count / (tiling(self.array).areas * N_PER_KPA_MM2)


def sensor_plans(config: schema.Config, report: Report = lambda _: None) -> tuple[SensorPlan, ...]:
    """Plan every sensor; a TactileError names the sensor, or the two that want the same messages of a bus.

    `report` gets a line before and after each whose cover must be solved, as that may take seconds.
    """
    plans: list[SensorPlan] = []
    for name, sensor in config.sensor.items():
        plans.append(_reported(name, sensor, f"{len(plans) + 1} of {len(config.sensor)}", report))
    check_buses(config, plans)
    return tuple(plans)


def _reported(name: str, sensor: schema.Sensor, place: str, report: Report) -> SensorPlan:
    began: list[float] = []

    def solving() -> None:
        report(f"{name}: solving the cover ({place})")
        began.append(monotonic())

    plan = sensor_plan(name, sensor, solving=solving)
    if began:
        report(f"{name}: cover solved in {monotonic() - began[0]:.1f} s")
    return plan


def check_buses(config: schema.Config, plans: Iterable[SensorPlan]) -> None:
    """ConfigError where two sensors want the same messages of a bus, or one wants longer ones than it carries."""
    codecs: dict[str, dict[str, Codec]] = {bus: {} for bus in config.bus}
    for plan in plans:
        codecs[plan.bus][plan.name] = plan.codec
        if not classic(config.bus[plan.bus]):
            continue
        messages = plan.codec.encode(np.zeros(plan.codec.size, np.uint16), 0, 0.0)
        longest = max(messages, key=lambda each: len(each.data))
        if len(longest.data) > CLASSIC:
            raise ConfigError(
                f"sensor.{plan.name}.codec: message {longest.id:#x} has {len(longest.data)} bytes, and bus "
                f"{plan.bus} is not CAN FD: set bus.{plan.bus}.fd = true"
            )
    for each in codecs.values():
        Router(each)


def sensor_plan(
    name: str,
    sensor: schema.Sensor,
    file: CalibrationFile | None = None,
    solving: Callable[[], object] = lambda: None,
) -> SensorPlan:
    """Solve the cover and build the operator of one sensor; a TactileError names the sensor.

    With `file` it is calibrated by that one, else by the configured one where it is there. `solving` is called
    before a cover is solved that is not in the cache.
    """
    try:
        return _plan(name, sensor, file or configured_file(sensor), solving)
    except TactileError as error:
        raise type(error)(f"sensor.{name}: {error}") from error


def configured_file(sensor: schema.Sensor) -> CalibrationFile | None:
    """The calibration file of a sensor; None where none is configured, or it is not there yet."""
    path = sensor.calibration.file
    return None if path is None else calibration_file.load(path)


def without_file(sensor: schema.Sensor) -> schema.Sensor:
    """A sensor as it is configured, but for its calibration file."""
    return sensor.model_copy(update={"calibration": sensor.calibration.model_copy(update={"file": None})})


def _plan(
    name: str, sensor: schema.Sensor, file: CalibrationFile | None, solving: Callable[[], object]
) -> SensorPlan:
    array, codec = make_array(sensor), make_codec(sensor)
    if codec.size != array.size:
        raise ConfigError(f"the codec carries {codec.size} taxels and the array has {array.size}: they must agree")
    stack = make_stack(sensor)
    if file:
        _check_file(name, sensor, file, array.size, stack)
    calibration = make_calibration(sensor, file)
    calibrated = sensor.calibration.kpa_per_count is not None or calibration.curves is not None
    _check_forces(sensor.calibration, codec, calibrated)
    Calibrator(calibration, array.size)  # refuses a dead taxel that the array does not have
    refine = surface.cells_a_pitch(array, sensor.refine)
    _check_cells(array, refine)
    cover = file.cover if file else None
    kernel = make_kernel(sensor.kernel, stack, cover, solving)
    blur = surface.make(kernel, array, refine)
    if cover:
        blur.thickness_error = cover.fit.thickness_error
    restores_shear = calibrated and calibration.shear_n_per_count is not None and all(kernel.stack.bonds)
    place = sensor.array.model_dump(include={"frame_id", "origin_mm", "orientation"}, exclude_none=True)
    return SensorPlan(
        name=name,
        bus=sensor.bus,
        codec_name=sensor.codec.name,
        codec=codec,
        array=array,
        kernel=kernel,
        blur=blur,
        cells=raster(array, refine),
        calibration=calibration,
        method=named(sensor.method),
        budget_s=None if sensor.budget_ms is None else 1e-3 * sensor.budget_ms,
        stale_after_s=sensor.stale_after_s,
        warnings=_constant_warnings(None if calibrated else sensor.calibration, summarise(kernel, array), array),
        calibrated=calibrated,
        file=file,
        pose=Pose(**place) if place else None,
        coupled=surface.coupled(kernel.stack, blur, array) if restores_shear else None,
    )


def _check_file(name: str, sensor: schema.Sensor, file: CalibrationFile, size: int, stack: Stack) -> None:
    """ConfigError if a file is of another array, or contradicts the configuration."""
    path = sensor.calibration.file
    place = "calibration" if path is None else path.name
    try:
        file.need_fit(name, sensor.codec.name, size, stack)
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from error
    if path is None:  # applied until the end of the service: it replaces what is configured
        return
    for key, section in (("kpa_per_count", file.gain), ("no_load", file.no_load)):
        if section is not None and (value := getattr(sensor.calibration, key)) is not None:
            raise ConfigError(f"calibration.{key} = {value:g}: {place} holds it, too: take one of them out")


def _check_cells(array: Array, refine: int) -> None:
    """ConfigError where a grid's image has too many cells to be restored in time."""
    if array.shape is None:
        return
    cells, side = array.size * refine**2, max(array.shape) * refine
    if cells > MAX_CELLS or side > MAX_CELLS_IN_A_ROW:
        raise ConfigError(
            f"refine = {refine}: {array.size} taxels then have {cells} cells, up to {side} in a row: "
            f"give at most {MAX_CELLS}, and {MAX_CELLS_IN_A_ROW} in a row"
        )


def _check_forces(calibration: schema.Calibration, codec: Codec, calibrated: bool) -> None:
    """ConfigError where shear is to be in newtons, but the skin measures none or pressure is not in kPa."""
    if calibration.shear_n_per_count is None:
        return
    setting = f"calibration.shear_n_per_count = {calibration.shear_n_per_count:g}"
    if not isinstance(codec, ShearCodec):
        raise ConfigError(f"{setting}: the codec carries no shear: leave it out")
    if not calibrated:
        raise ConfigError(f"{setting}: forces need kpa_per_count, too: give both")


def _constant_warnings(
    uncalibrated: schema.Calibration | None, summary: CoverSummary, array: Array
) -> tuple[FrameWarning, ...]:
    """Warnings of every image of a sensor; `uncalibrated` are the settings of one that has no gain."""
    warnings = []
    if uncalibrated:
        unused = "; noise_kpa is not used" if uncalibrated.noise_kpa else ""
        warnings.append(warning("uncalibrated", unused=unused))
    if summary.smallest_gap > THICK_FROM_PITCHES * array.pitch:
        gap = f"finer than {summary.smallest_gap:.2g} mm" if np.isfinite(summary.smallest_gap) else "at all"
        warnings.append(warning("thick_cover", pitch_mm=array.pitch, gap=gap))
    return tuple(warnings)


def make_stack(sensor: schema.Sensor) -> Stack:
    """Cover over substrate on a rigid base, sensed under the cover."""
    layers = (*sensor.cover, *sensor.substrate)
    return Stack(
        layers=tuple(Layer(each.thickness_mm, each.young_mpa, each.poisson) for each in layers),
        sensing=len(sensor.cover),
        bonds=tuple(each.bonded for each in layers),
    )


def make_array(sensor: schema.Sensor) -> Array:
    """The array as configured, or as its skin has it; ConfigError where both are incomplete."""
    array = sensor.array
    positions = (
        sensor.codec.settings.positions if array.positions_mm is None else np.array(array.positions_mm, float)
    )
    if positions is not None:
        for key in ("rows", "columns", "pitch_mm"):
            if (value := getattr(array, key)) is not None:
                raise ConfigError(f"array.{key} = {value}: belongs to a grid, and this array has positions")
        return replace(layout(positions, array.aperture_mm, array.aperture or "round"), beyond=array.beyond_mm)
    if array.rows is None or array.columns is None or array.pitch_mm is None:
        raise ConfigError("array is incomplete: give rows, columns and pitch_mm, or positions_mm")
    size = array.rows, array.columns, array.pitch_mm
    return replace(grid(*size, array.aperture_mm, array.aperture or "square"), beyond=array.beyond_mm)


def make_codec(sensor: schema.Sensor) -> Codec:
    """The codec of a sensor; ConfigError where the array is larger than it can carry."""
    return skins.make(sensor.codec.name, sensor.codec.settings, make_array(sensor))


def make_kernel(
    settings: schema.Kernel, stack: Stack, cover: CoverSection | None, solving: Callable[[], object] = lambda: None
) -> Kernel:
    """The cover as configured and as thick as it was fitted, or as measured; ConfigError where it was not."""
    if settings.model != "measured":
        stack = stack.thickened(cover.factor) if cover else stack
        return cached(stack, settings.model, settings.accuracy, report=LOG.warning, solving=solving)
    if cover is None or cover.kernel is None:
        raise ConfigError('kernel.model = "measured": the calibration file holds no kernel: give fem or layered')
    q, gain = (np.array(each) for each in cover.kernel)
    error = cover.fit.thickness_error * float(np.abs(np.gradient(gain[1:], np.log(q[1:]))).max())
    return Kernel(stack.thickened(cover.factor), "measured", q, gain, *radial(q, gain), error_estimate=error)


def make_calibration(sensor: schema.Sensor, file: CalibrationFile | None = None) -> Calibration:
    """Calibration from the file, else from the configuration, else the codec's default."""
    skin, settings = sensor.codec.settings, sensor.calibration.model_dump(exclude_none=True, exclude={"file"})
    defaults = {"kpa_per_count": skin.kpa_per_count, "no_load": skin.no_load}
    settings = {key: value for key, value in defaults.items() if value is not None} | settings
    if file and file.gain:
        curves = file.gain.curves
        settings |= {"curves": curves, "kpa_per_count": float(np.median(curves.gain))}
    elif sensor.calibration.kpa_per_count is None:
        settings.pop("noise_kpa", None)  # nothing is in kPa yet: the noise is measured, in counts
    if file and file.no_load:
        values = file.no_load.values
        settings["no_loads"] = np.where(np.isnan(values), settings.get("no_load", 0.0), values)
    if file and file.health:
        settings["dead"] = tuple(sorted({*sensor.calibration.dead, *file.health.dead}))
        settings["noise_counts"] = np.array(file.health.noise_counts, float)
    return Calibration(**settings)
