"""`tactiled calibrate`: the calibration file of an array, from recordings."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from tactiled import surface
from tactiled.build import make_array, make_codec, make_kernel, make_stack
from tactiled.calibrate import calibration_file
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.counts.means import Rails
from tactiled.calibrate.counts.plateaus import noise
from tactiled.calibrate.counts.reference import read_reference
from tactiled.calibrate.sections import Origin, Section, build, gain_sections, utc
from tactiled.cli import options
from tactiled.config import schema
from tactiled.errors import ConfigError
from tactiled.files import sha256
from tactiled.geometry import Array
from tactiled.recorded.offline import read_frame_series
from tactiled.units import number_text

if TYPE_CHECKING:
    from tactiled.calibrate.counts.gain import GainFit
    from tactiled.frames import FrameSeries

MAX_DEAD_LISTED = 12
Out = Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write, or to bring up to date.")]


def gain(
    file: options.Recording,
    config: options.RecordedConfig,
    out: Out,
    steps_kpa: Annotated[
        str | None,
        typer.Option(help="Pressures that the whole array bore, in their order, the first 0: 0,10,20,30,20,10,0."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Log beside the recording (CSV): time_s and force_n or pressure_kpa.")
    ] = None,
    weight_n: Annotated[float | None, typer.Option(help="Force of one weight laid on the array, N.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Chart of counts against pressure (.png, .svg, .pdf).")] = None,
    sensor: options.Sensor = None,
) -> None:
    """Find each taxel's gain and curve in a recording under known loads."""
    loads = options.present(steps_kpa=steps_kpa, reference=reference, weight_n=weight_n)
    if len(loads) != 1:
        raise ConfigError("give one of --steps-kpa, --reference and --weight-n")
    settings, name, one = options.one_sensor(config, sensor)
    if before := calibration_file.load(out):
        matching(out, before, name, one)
    from tactiled.calibrate.counts.gain import unlike_gain

    with threadpool_limits(1):
        series = read_frame_series(file, name, settings)
        fit = _fit(series, one, before, steps_kpa, reference, weight_n)
    gain_before = one.calibration.kpa_per_count  # None: uncalibrated
    if before and before.gain:
        gain_before = float(np.median(before.gain.curves.gain))
    fit = replace(fit, notes=(*unlike_gain(fit.curves, gain_before), *fit.notes))
    (load,) = (f"{key.replace('_', ' ')} {getattr(value, 'name', value)}" for key, value in loads.items())
    new = gain_sections(fit, noise(series.counts), made_from(file, f"gain: {load}"[:200]))
    if plot is not None:
        from tactiled.charts.calibration import draw_gain  # matplotlib takes a second

        draw_gain(plot, fit)
    update(out, before, name, one, new)
    typer.echo("\n".join([f"{name}: {load}", *_lines(fit)]))
    typer.echo(f"{out}: written; give it as calibration.file of the sensor, then calibrate the cover")


def show(file: Annotated[Path, typer.Argument(help="Calibration file.")]) -> None:
    """Print what a calibration file holds."""
    content = calibration_file.load(file)
    if content is None:
        raise ConfigError(f"{file}: no such file")
    typer.echo(f"{file}: {content.sensor}, {content.codec}, {content.taxels} taxels, id {content.id}")
    for name, section in content.sections.items():
        origin = section.origin
        typer.echo(f"  {name:<9} {origin.created}  {origin.method}  ({origin.recording})")
    if content.gain is not None:
        curves = content.gain.curves
        typer.echo(f"  gain      {curves.form}, {_spread(curves.gain)} kPa per count")
        typer.echo(f"            {np.count_nonzero(curves.individual)} of {curves.size} taxels have their own")
        typer.echo(f"            standard error {_worst(100 * curves.deviation, '%')}")
        typer.echo(f"            error elsewhere {_elsewhere(curves)}")
        if curves.loop is not None:
            typer.echo(f"            hysteresis of {curves.loop.percent:.2g} % of full scale is taken off")
    if content.cover is not None:
        (low, high), fit = content.cover.interval_mm, content.cover.fit
        interval = f"{fit.thickness_mm:.4g} mm (95 %: {low:.4g} to {high:.4g})"
        typer.echo(f"  cover     {interval}, {fit.factor:.3f} times the configured one")
    if content.health is not None:
        typer.echo(f"  health    dead: {_listed(content.health.dead)}")


def matching(path: Path, file: CalibrationFile, name: str, sensor: schema.Sensor) -> CalibrationFile:
    """The file at `path`; ConfigError where it is of another array, or its cover of other layers."""
    try:
        file.need_fit(name, sensor.codec.name, make_array(sensor).size, make_stack(sensor))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    return file


def made_from(recording: Path, method: str) -> Origin:
    """Origin of a section that is made now."""
    digest, created = sha256(recording), utc(time.time())
    return build(Origin, recording=recording.name[-255:], sha256=digest, method=method, created=created)


def update(
    out: Path, before: CalibrationFile | None, name: str, sensor: schema.Sensor, sections: dict[str, Section]
) -> None:
    """Write a calibration file with these sections, and the others that it had."""
    codec, taxels = sensor.codec.name, make_array(sensor).size
    calibration_file.save(out, calibration_file.with_sections(before, name, codec, taxels, **sections))


def _fit(
    series: "FrameSeries",
    sensor: schema.Sensor,
    before: CalibrationFile | None,
    steps_kpa: str | None,
    reference: Path | None,
    weight_n: float | None,
) -> "GainFit":
    """Fit by the one load that is given."""
    from tactiled.calibrate.counts import force_gain
    from tactiled.calibrate.counts import gain as uniform

    array, configured = make_array(sensor), sensor.calibration
    sign = float(np.sign(configured.kpa_per_count or sensor.codec.settings.kpa_per_count or 0))
    rails = Rails.of(configured.saturation, make_codec(sensor).ends, sign)
    series = series.without(sensor.calibration.dead)
    if steps_kpa is not None:
        return uniform.fit_steps(series, options.numbers("steps-kpa", steps_kpa), rails, array)
    if weight_n is not None:
        return force_gain.fit_weight(series, weight_n, array, rails, _reach(sensor, before, array))
    assert reference is not None
    log = read_reference(reference)
    if log.quantity == "force_n":
        return force_gain.fit_force(series, log, array, rails, _reach(sensor, before, array))
    return uniform.fit_pressure(series, log, rails, array)


def _reach(sensor: schema.Sensor, file: CalibrationFile | None, array: Array) -> np.ndarray | None:
    """Share (N,) of a load above each taxel that the array senses by its cover; None: that is to be measured."""
    from tactiled.calibrate.counts.force_gain import reach_of

    cover = file.cover if file else None
    if sensor.kernel.model == "measured" and (cover is None or cover.kernel is None):
        return None
    return reach_of(surface.make(make_kernel(sensor.kernel, make_stack(sensor), cover), array, 1), array)


def _lines(fit: "GainFit") -> list[str]:
    """What was found, a line each."""
    curves, live = fit.curves, np.setdiff1d(np.arange(fit.curves.size), fit.dead)
    ends = curves.reach_counts.sum(axis=1)
    reach = fit.points.pressure.max() if fit.force_n is None else np.median(curves.pressure(ends)[live])
    largest = "" if fit.force_n is None else f"; the largest load is {number_text(fit.force_n.max())} N"
    scores = ", ".join(f"{form} {100 * each:.2g} %" for form, each in fit.scores.items() if np.isfinite(each))
    own = np.count_nonzero(curves.individual)
    rows = {
        "curve": curves.form + (f" (rms error of left-out points: {scores})" if scores else ""),
        "gain": f"{_spread(curves.gain[live])} kPa per count; {own} of {curves.size} taxels have their own",
        "standard error": _worst(100 * curves.deviation, "%"),
        "error elsewhere": _elsewhere(curves),
        "hysteresis": _worst(curves.hysteresis, "% of full scale"),
        "calibrated": f"up to {number_text(reach)} kPa, {np.median(np.abs(ends)[live]):.0f} counts over no load "
        f"(median taxel){largest}",
        "dead": _listed(fit.dead),
    }
    if fit.alignment is not None:
        rows["clocks"] = f"log {fit.alignment.text}"
    return [f"  {key:<15} {row}" for key, row in rows.items()] + [f"  {each}" for each in fit.notes]


def _listed(dead: tuple[int, ...]) -> str:
    names = ", ".join(map(str, dead[:MAX_DEAD_LISTED])) + (" ..." if len(dead) > MAX_DEAD_LISTED else "")
    return f"{len(dead)} ({names})" if dead else "none"


def _spread(gains: np.ndarray) -> str:
    return f"{np.median(gains):.4g} (median; {gains.min():.4g} to {gains.max():.4g})"


def _elsewhere(curves: Curves) -> str:
    """Error of another rise or fall of the pressure than those of the fit."""
    if curves.error_kpa is None or not np.isfinite(curves.error_kpa).any():
        return "unknown: raise the pressure of the whole array, and lower it"
    return f"{_worst(curves.error_kpa, 'kPa rms')}, in a rise or fall that was left out; hysteresis is in it"


def _worst(values: np.ndarray, unit: str) -> str:
    """Median and worst of values (N,), NaN: unknown."""
    if not np.isfinite(values).any():
        return "unknown"
    worst = int(np.nanargmax(values))
    return f"{np.nanmedian(values):.2g} {unit} (median), {values[worst]:.2g} (worst, taxel {worst})"
