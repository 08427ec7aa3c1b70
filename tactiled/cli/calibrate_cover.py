"""`tactiled calibrate cover`: a cover's thickness from a recording of presses."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from tactiled.arrays import Floats
from tactiled.build import configured_file, make_array, make_calibration, make_codec, make_stack
from tactiled.calibrate import calibration_file
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.cover.fit import MAX_EDGE_MM, MAX_TIP_MM, MIN_SIZE_MM, CoverFit, Method
from tactiled.calibrate.cover.recorded_touch import RecordedTouch, fit_touch
from tactiled.calibrate.cover.unknowns import Unknowns
from tactiled.calibrate.sections import CoverSection
from tactiled.cli import options
from tactiled.cli.calibrate import Out, made_from, matching, update
from tactiled.config import schema
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError
from tactiled.recorded.offline import read_frame_series


def cover(
    file: options.Recording,
    config: options.RecordedConfig,
    out: Out,
    tip_mm: Annotated[
        float | None, typer.Option(help="Presses with a flat round tip of this diameter, mm; 0: unknown.")
    ] = None,
    sphere: Annotated[
        bool, typer.Option("--sphere", help="The tip is round: give the contact's diameter.")
    ] = False,
    places: Annotated[
        Path | None, typer.Option(help="Where the tip pressed (CSV): x_mm,y_mm of every press, in order.")
    ] = None,
    edge: Annotated[bool, typer.Option("--edge", help="A straight edge was laid across the array.")] = False,
    edge_mm: Annotated[float | None, typer.Option(help="A straight ridge of this width, mm.")] = None,
    blind: Annotated[bool, typer.Option("--blind", help="Anything may have touched the array.")] = False,
    measured: Annotated[
        bool, typer.Option("--measured", help="Keep a measured kernel where no thickness explains the presses.")
    ] = False,
    error: Annotated[
        list[str] | None,
        typer.Option(help="Its standard deviation: size_mm=, aperture_mm=, poisson=, curvature=, profile=VALUE."),
    ] = None,
    doubtful: Annotated[
        bool, typer.Option("--doubtful", help="Write a result, too, that the presses speak against.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Chart of the response, measured and fitted (.png, .svg, .pdf).")
    ] = None,
    sensor: options.Sensor = None,
) -> None:
    """Find a cover's thickness in a recording of presses."""
    way, size_mm = _way(tip_mm is not None, edge or edge_mm is not None, blind), _size(tip_mm, edge_mm)
    _refuse({"--sphere": sphere, "--places": places} if way != "tip" else {}, "needs --tip-mm")
    unused = {"--measured": measured, "--plot": plot, "--error": error, "--doubtful": doubtful}
    _refuse(unused if blind else {}, "has no effect with --blind: leave it out")
    with threadpool_limits(1):
        recorded, name, one, before = _recorded(file, config, sensor, out)
        places_mm = None if places is None else _places(places)
        fit = fit_touch(recorded, way, size_mm, sphere, places_mm, _unknowns(error or []))
        if plot is not None:
            from tactiled.charts.calibration import draw_cover  # matplotlib takes a second

            draw_cover(plot, fit, recorded.stack)
    kept = fit if measured else replace(fit, kernel=None)
    section = CoverSection.of(kept, recorded.stack, made_from(file, f"cover: {fit.method}"))
    typer.echo("\n".join([f"{name}: cover by {fit.method}", *_lines(fit, recorded.stack, measured)]))
    if fit.objection and not (doubtful or section.kernel):
        raise ConfigError(f"cover: {fit.objection}; nothing is written (--doubtful writes it)")
    update(out, before, name, one, {"cover": section})
    typer.echo(f"{out}: written; give it as calibration.file of the sensor")


def _way(tip: bool, edge: bool, blind: bool) -> Method:
    """The one way that was asked for; ConfigError for none, or several."""
    if tip + edge + blind != 1:
        raise ConfigError("give one of --tip-mm, --edge (or --edge-mm) and --blind")
    return "blind" if blind else "edge" if edge else "tip"


def _recorded(
    file: Path, config: Path, sensor: str | None, out: Path
) -> tuple[RecordedTouch, str, schema.Sensor, CalibrationFile | None]:
    """The recording; its sensor's name and configuration, and the other sections of its calibration file.

    That is the one to bring up to date, else the configured one: the fit uses its gain and no load.
    """
    settings, name, one = options.one_sensor(config, sensor)
    before, path = calibration_file.load(out), out
    if before is None and one.calibration.file is not None:
        before, path = configured_file(one), one.calibration.file
    before = before and matching(path, before.model_copy(update={"cover": None}), name, one)
    series, ends = read_frame_series(file, name, settings), make_codec(one).ends
    calibration = make_calibration(one, before)
    return RecordedTouch(series, make_array(one), make_stack(one), calibration, ends), name, one, before


def _size(tip_mm: float | None, edge_mm: float | None) -> float | None:
    """Size of what pressed (mm), None where it is unknown; ConfigError where it is none of a tip or ridge."""
    option, size_mm, highest_mm = "--edge-mm", edge_mm, MAX_EDGE_MM
    if tip_mm is not None:
        option, size_mm, highest_mm = "--tip-mm", tip_mm or None, MAX_TIP_MM
    if size_mm is not None and not MIN_SIZE_MM <= size_mm <= highest_mm:
        raise ConfigError(f"{option} {size_mm:g}: give {MIN_SIZE_MM:g} to {highest_mm} mm")
    return size_mm


def _unknowns(errors: list[str]) -> Unknowns:
    """The deviations that were given; ConfigError for one that is none."""
    names, deviations = [each.name for each in fields(Unknowns)], {}
    for text in errors:
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        if name not in names or not 0 < value < np.inf:
            raise ConfigError(f"--error {text}: give NAME=VALUE with a number over 0; names: {', '.join(names)}")
        deviations[name] = value
    return Unknowns(**deviations)


def _refuse(options: Mapping[str, object], reason: str) -> None:
    """ConfigError for the first option that is set."""
    for name, value in options.items():
        if value:
            raise ConfigError(f"{name} {reason}")


def _places(path: Path) -> Floats:
    """Places (K, 2) in mm; ConfigError names what is wrong with the file."""
    try:
        header, *lines = path.read_text("utf-8-sig").splitlines() or [""]
        rows = np.array([line.split(",") for line in lines if line.strip()], float)
        is_valid = header.replace(" ", "") == "x_mm,y_mm" and rows.shape[1:] == (2,) and np.isfinite(rows).all()
    except OSError as error:
        raise ConfigError(f"--places {path}: {error.strerror}") from error
    except ValueError:
        is_valid = False
    if not is_valid:
        raise ConfigError(f"--places {path}: give a first line x_mm,y_mm, then two numbers a line")
    return rows


def _lines(fit: CoverFit, stack: Stack, measured: bool) -> list[str]:
    """What was found, a line each; a `measured` kernel is kept."""
    (low, high), change = fit.interval_mm, 100 * (fit.factor - 1)
    from_mm, to_mm = (each * stack.depth for each in fit.effective or fit.interval)
    rows = {
        "thickness": f"{fit.thickness_mm:.4g} mm (95 %: {low:.4g} to {high:.4g}); configured {stack.depth:.4g} mm",
        "effective": f"{from_mm:.4g} to {to_mm:.4g} mm (95 %) restores with aperture and layers as configured",
        "factor": f"{fit.factor:.3f} ({change:+.1f} %)",
        "presses": f"{fit.presses} used",
        "left out": f"presses left out of the fit miss by {fit.residual:.2f} times what noise and gains explain",
    }
    if fit.kernel is not None:
        kept = "" if measured else ", not kept: give --measured"
        rows["kernel"] = f"measured at {fit.kernel.shape[1]} frequencies{kept}"
    return [f"  {key:<10} {row}" for key, row in rows.items()] + [f"  note: {each}" for each in fit.notes]
