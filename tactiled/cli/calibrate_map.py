"""`tactiled calibrate map`: whether taxels are mirrored, transposed or swapped."""

from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from tactiled.build import configured_file, make_array, make_calibration, make_codec
from tactiled.calibrate.counts.means import unknown_taxels
from tactiled.calibrate.cover.recorded_presses import noise_of, pressures
from tactiled.calibrate.upkeep.taxel_map import Direction, check_map
from tactiled.cli import options
from tactiled.errors import ConfigError
from tactiled.recorded.offline import read_frame_series

UNLOADED_PERCENTILE = 10  # of what a taxel reads: a finger that rolls over all is on each of them for a short time
EXIT_DOUBTED = 1  # as of `tactiled check`


def map(  # noqa: A001, the verb's name
    file: options.Recording,
    config: options.RecordedConfig,
    direction: Annotated[
        Direction | None, typer.Option(help="Where the finger rolled, once, as seen in the viewer.")
    ] = None,
    sensor: options.Sensor = None,
) -> None:
    """Judge by a recording of a rolling finger whether the taxels lie where the configuration says."""
    settings, name, one = options.one_sensor(config, sensor)
    calibration, array = make_calibration(one, configured_file(one)), make_array(one)
    with threadpool_limits(1), unknown_taxels():
        series = read_frame_series(file, name, settings)
        pressure, _ = pressures(series, calibration, make_codec(one).ends)
        pressure -= np.nanpercentile(pressure, UNLOADED_PERCENTILE, axis=0)
        verdict = check_map(pressure, array, noise_of(pressure, calibration), direction)
    if verdict.order is None:
        raise ConfigError(f"{file}: {verdict.text}")
    typer.echo(f"{name}: {verdict.text}")
    if verdict.text != "as configured":
        typer.echo("change the codec or the array so that every taxel lies where the finger was")
        raise typer.Exit(EXIT_DOUBTED)
