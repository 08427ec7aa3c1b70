"""`tactiled check`: whether a configuration is right, and what its cover will do to its array."""

from collections.abc import Mapping
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.build import SensorPlan
from tactiled.cli import options
from tactiled.config import load, tls
from tactiled.cover.summary import CoverSummary, summarise
from tactiled.interop.foxglove import need
from tactiled.runtime.service import Service
from tactiled.runtime.state import StateFile, default_path

NO_GAP_MM = 1e3  # wider than any array


def check(config: options.Config) -> None:
    """Check a configuration, and print the effect of each cover on its array."""
    with threadpool_limits(1):
        service = prepared(config)
    tls.context(service.config.server)
    if service.config.server.foxglove is not None:
        need("server.foxglove")
    for sensor in service.sensors.values():
        plan = sensor.plan
        Console(soft_wrap=True, highlight=False).print(_table(plan, summarise(plan.kernel, plan.array)))
        for warning in plan.warnings:
            typer.echo(f"  {warning.text}")
    typer.echo(f"{config} is valid: {_count(service.sensors, 'sensor')}, {_count(service.buses, 'bus')}")


def prepared(config: Path) -> Service:
    """The service of a configuration file, all of it made and nothing started."""
    settings = load(config)
    return Service(settings, state=StateFile(settings.server.state or default_path(config)))


def _count(named: Mapping[str, object], noun: str) -> str:
    plural = noun + ("es" if noun.endswith("s") else "s")
    return f"{len(named)} {noun if len(named) == 1 else plural}"


def _table(plan: SensorPlan, summary: CoverSummary) -> Table:
    """What a person wants to know of one sensor before it runs."""
    table, array = Table(show_header=False, title_justify="left"), plan.array
    table.title = f"{plan.name}: {plan.codec_name} on {plan.bus}"
    shape = " x ".join(map(str, array.frame_shape))
    rows = {
        "array": f"{shape} taxels, pitch {array.pitch:g} mm, {array.aperture} aperture of {array.width:g} mm",
        "messages a frame": f"{plan.codec.segments}",
        "cover": f"solved by {plan.kernel.model}, gain right to {plan.kernel.error_estimate:.1g}",
    }
    for row in (rows | summary_rows(summary)).items():
        table.add_row(*row)
    return table


def summary_rows(summary: CoverSummary, noise: float = 0.01) -> dict[str, str]:
    """What a cover does to an array, in words; `noise` over the indenters' pressure."""
    gap = f"{summary.smallest_gap:.2f} mm (the {summary.limit} sets it)"
    if summary.smallest_gap >= NO_GAP_MM:
        gap = "none is resolvable"
    return {
        "gain 0.5 / 0.1 at": f"{summary.half_gain:.3f} / {summary.tenth_gain:.3f} cycles/mm",
        "gain at the taxel Nyquist": f"{summary.nyquist_gain:.4f} at {summary.nyquist:.3f} cycles/mm",
        "noise amplification of full restoration": f"{summary.noise_gain:.1f} times",
        "smallest resolvable gap": f"{gap}, at a noise of {100 * noise:g} % of the pressure",
    }
