"""`tactiled cover`: a cover's gain, and what it means for an array."""

import json
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tactiled.arrays import Floats
from tactiled.build import configured_file, make_array, make_stack
from tactiled.cli import options
from tactiled.cli.calibrate import matching
from tactiled.cli.check import summary_rows
from tactiled.cover.fem import Press, pressed
from tactiled.cover.kernel import Kernel, solve
from tactiled.cover.stack import Layer, Profile, Stack
from tactiled.cover.summary import CoverSummary, summarise
from tactiled.errors import ConfigError
from tactiled.geometry import Array, grid

LAYER_HELP = (
    "T,E,NU of one layer in place of the cover's three options; repeat it from the top down. "
    "T,E,NU,loose slides on the layer under it."
)
PROFILE_HELP = (
    "R,RISE: at radius R mm the top layer is RISE mm thicker; repeat it from R = 0 out to a RISE of 0 "
    "for a boss, a dimple (RISE below 0) or an edge round the load."
)
COVER, BASE = ("thickness", "young", "poisson"), ("sensor_thickness", "sensor_young", "sensor_poisson")
REPLACED = {
    "layer": COVER,
    "config": (*COVER, "layer", *BASE, "pitch"),
}  # options that have no effect beside the one that names them here
ROUND_FREQUENCIES = (np.array([1, 1.5, 2, 3, 5, 7]) * 10.0 ** np.arange(-6, 4)[:, None]).round(9).ravel()  # 1/mm


def cover(
    context: typer.Context,
    thickness: Annotated[float, typer.Option(help="Cover: thickness, mm.")] = 0.2,
    young: Annotated[float, typer.Option(help="Cover: Young's modulus, MPa.")] = 98.0,
    poisson: Annotated[float, typer.Option(help="Cover: Poisson's ratio, 0 to less than 0.5.")] = 0.3,
    layer: Annotated[list[str] | None, typer.Option(help=LAYER_HELP)] = None,
    sensor_thickness: Annotated[float, typer.Option(help="Under the cover: thickness, mm.")] = 1.0,
    sensor_young: Annotated[float, typer.Option(help="Under the cover: Young's modulus, MPa.")] = 980.0,
    sensor_poisson: Annotated[float, typer.Option(help="Under the cover: Poisson's ratio.")] = 0.3,
    profile: Annotated[list[str] | None, typer.Option(help=PROFILE_HELP)] = None,
    footprint: Annotated[
        float | None, typer.Option(help="Press evenly on a disc of this radius, mm, and print the stress.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Take cover, as thick as calibrated, and array from this file.")
    ] = None,
    sensor: options.Sensor = None,
    pitch: Annotated[float, typer.Option(help="Distance between taxels, mm.")] = 1.0,
    noise: Annotated[float, typer.Option(help="A taxel's noise over the indenters' pressure.")] = 0.01,
    at: Annotated[str | None, typer.Option(help="Frequencies to print, 1/mm, with commas.")] = None,
    model: Annotated[Literal["fem", "layered"], typer.Option(help="Finite elements, or exact.")] = "fem",
    accuracy: Annotated[float, typer.Option(help="Of the finite elements' gain.")] = 1e-3,
    budget: Annotated[float, typer.Option(help="Time the finite elements may take, s.")] = 60.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw both models into FILE.svg or FILE.png.")] = None,
) -> None:
    """Print a cover's gain over spatial frequency, and the resolution that it leaves."""
    _refuse_unused(context)
    base = Layer(sensor_thickness, sensor_young, sensor_poisson)
    stack = _stack(layer, base) if layer else Stack((Layer(thickness, young, poisson), base))
    stack, array = _configured(config, sensor) if config else (stack, grid(1, 1, pitch))
    points = [options.numbers("profile", each, "R,RISE in mm", 2) for each in profile or ()]
    q, rise = None if at is None else _frequencies(at), Profile(*zip(*points, strict=True)) if points else None
    start, press = perf_counter(), None

    def late() -> bool:
        return perf_counter() > start + budget

    kernel = solve(stack, model, accuracy, rise, late)
    seconds, summary = perf_counter() - start, summarise(kernel, array, noise)
    if q is None:  # over which the gain falls
        ends = np.searchsorted(ROUND_FREQUENCIES, (summary.half_gain / 8, 2 * summary.tenth_gain))
        q = ROUND_FREQUENCIES[slice(*ends)]
    if footprint is not None:
        press = pressed(stack, footprint, accuracy, rise, late)
    if as_json:
        footprints = {"footprint": {"radius": footprint} | asdict(press)} if press else {}
        print(json.dumps(_record(kernel, q, seconds, summary) | footprints, default=np.ndarray.tolist))
    else:
        _show(kernel, q, seconds, summary, noise)
        if press:
            _show_press(footprint, press)
    if plot:
        _plot(plot, kernel)


def _refuse_unused(context: typer.Context) -> None:
    """ConfigError for the first option that another one takes the place of."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    present = {name for name, source in sources.items() if source and source.name == "COMMANDLINE"}
    for by, names in REPLACED.items():
        for name in names:
            if {by, name} <= present:
                raise ConfigError(f"--{name.replace('_', '-')} has no effect with --{by}: leave one of them out")
    if "sensor" in present and "config" not in present:
        raise ConfigError("--sensor needs --config")
    if "footprint" in present and context.params["model"] != "fem":
        raise ConfigError("--footprint needs --model fem: leave one of them out")


def _configured(config: Path, name: str | None) -> tuple[Stack, Array]:
    """Cover, as thick as it was fitted, and array of a sensor in a configuration file."""
    _, name, sensor = options.one_sensor(config, name)
    stack, file, path = make_stack(sensor), configured_file(sensor), sensor.calibration.file
    if file and path and (cover := matching(path, file, name, sensor).cover):
        stack = stack.thickened(cover.factor)
    return stack, make_array(sensor)


def _frequencies(text: str) -> Floats:
    """The values of --at, 1/mm."""
    q = np.array(options.numbers("at", text))
    if not (np.isfinite(q).all() and (q >= 0).all()):
        raise ConfigError(f"--at {text}: give finite frequencies of 0 or more, 1/mm")
    return q


def _stack(texts: list[str], base: Layer) -> Stack:
    """The layers of every --layer over the sensor."""
    form = "T,E,NU: thickness in mm, Young's modulus in MPa, Poisson's ratio"
    layers = [Layer(*options.numbers("layer", text.removesuffix(",loose"), form, 3)) for text in texts]
    bonds = (*(not text.endswith(",loose") for text in texts), True)
    return Stack((*layers, base), sensing=len(layers), bonds=bonds)


def _record(kernel: Kernel, q: Floats, seconds: float, summary: CoverSummary) -> dict[str, Any]:
    """What --json prints; null stands for infinity, which JSON does not have."""
    return {
        "model": kernel.model,
        "q": q,
        "gain": kernel.gain_at(q),
        "error_estimate": kernel.error_estimate,
        "seconds": seconds,
        "mesh": kernel.mesh,
        "unknowns": kernel.unknowns,
        "meaning": {name: None if value == np.inf else value for name, value in asdict(summary).items()},
    }


def _show(kernel: Kernel, q: Floats, seconds: float, summary: CoverSummary, noise: float) -> None:
    """Print the table of gains, what it means, and how far to trust it."""
    table = Table("q (1/mm)", "half wave (mm)", "gain", title="Gain of the cover")
    for frequency, gain in zip(q, kernel.gain_at(q), strict=True):
        half = f"{1 / (2 * frequency):.3g}" if frequency else "∞"
        table.add_row(f"{frequency:g}", half, f"{gain:.4f}")
    Console(highlight=False).print(table)
    for row in summary_rows(summary, noise).items():
        typer.echo(": ".join(row))
    columns, rows = kernel.mesh
    how = f"{columns} x {rows} elements, {kernel.unknowns} unknowns" if kernel.model == "fem" else "exact"
    typer.echo(f"error of the gain: {kernel.error_estimate:.1e} or less ({how}, {seconds * 1e3:.0f} ms)")


def _show_press(radius: float | None, press: Press) -> None:
    """Print the stress under a footprint: in the middle, and how far out."""
    middle = press.stress[0]
    half, tenth = (press.r[np.flatnonzero(press.stress >= part * middle)[-1]] for part in (0.5, 0.1))
    typer.echo(
        f"Pressed on a disc of {radius:g} mm radius: {middle:.3f} of the pressure in the middle, half of that "
        f"{half:.2g} mm and a tenth {tenth:.2g} mm from it; "
        f"error {press.error_estimate:.1e} of the pressure or less."
    )


def _plot(path: Path, kernel: Kernel) -> None:
    """Draw the kernel beside the other model's, which is of flat layers only."""
    from tactiled.charts.style import two_models  # matplotlib takes half a second that only this option needs

    if kernel.profile:
        raise ConfigError("--plot draws both models, and the exact one has no --profile: leave one of them out")
    kernels = {
        model: kernel if model == kernel.model else solve(kernel.stack, model) for model in ("fem", "layered")
    }
    two_models(path, kernels["fem"], kernels["layered"])
