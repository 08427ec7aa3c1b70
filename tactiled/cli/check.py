"""`tactiled check`: whether a configuration is right, and what its cover will do to its array."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.build import SensorPlan
from tactiled.cli import options
from tactiled.cli.sniff import listen, survey_lines
from tactiled.config import Config, faults_between_sections, load, load_as_meant, tls_context
from tactiled.cover.summary import CoverSummary, summarise
from tactiled.errors import ConfigError
from tactiled.live.service import Service
from tactiled.live.state_file import StateFile
from tactiled.messages.foxglove import need
from tactiled.plausibility.settings import Finding, config_findings, refused, unedited
from tactiled.plausibility.traffic import bus_report

EXIT_DOUBTFUL = 1
NO_GAP_MM = 1e3  # wider than any array


def check(
    config: options.Config,
    bus: Annotated[
        bool, typer.Option("--bus", help="Listen to each bus, too, and hold what comes against the file.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="How long to listen to each bus.", min=0.05, max=3600)] = 3.0,
) -> None:
    """Check a configuration, and print the effect of each cover on its array.

    The exit code is 0 if all is well, 1 if a value is doubtful, and 2 if the file or a bus cannot be used.
    `--bus` only listens: a skin that waits until the service asks or starts it stays silent.
    """
    findings = findings_of(config)
    _print(findings)  # before covers are solved: a wrong value may make that impossible
    with threadpool_limits(1):
        service = prepared(config)
    tls_context(service.config.server)
    if service.config.server.foxglove is not None:
        need("server.foxglove")
    for sensor in service.sensors.values():
        plan = sensor.plan
        Console(soft_wrap=True, highlight=False).print(_table(plan, summarise(plan.kernel, plan.array)))
        for warning in plan.warnings:
            typer.echo(f"  {warning.text}")
    sensors = service.config.sensor.values()
    pushed = {each.bus for each in sensors if each.codec.name == "pushed"}  # into `run` alone
    for name in [each for each in service.config.bus if each not in pushed] if bus else ():
        findings += (more := _bus(service.config, name, seconds))
        _print(more)
    if count := sum(not each.hint for each in findings):
        typer.echo(f"{config} is doubtful: {count} finding{'s' * (count > 1)}")
        raise typer.Exit(EXIT_DOUBTFUL)
    typer.echo(f"{config} is valid: {_count(service.sensors, 'sensor')}, {_count(service.buses, 'bus')}")


def findings_of(config: Path) -> list[Finding]:
    """What is hard to believe of a configuration file; printed where ConfigError says what cannot be."""
    try:
        settings = load(config)
    except ConfigError as error:
        if (meant := load_as_meant(config)) is None:
            raise
        other, replaced = meant
        _print([each for each in config_findings(other) if not each.rests_on(replaced)])
        faults = [f"{config}: {each}" for each in (*faults_between_sections(other), *refused(other, replaced))]
        raise ConfigError("\n".join(dict.fromkeys([*str(error).splitlines(), *faults]))) from error
    findings = unedited(config.read_text("utf-8")) + config_findings(settings)
    if faults := [f"{config}: {each}" for each in refused(settings)]:
        _print(findings)
        raise ConfigError("\n".join(faults))
    return findings


def _print(findings: list[Finding]) -> None:
    for each in findings:
        typer.echo(f"{'hint' if each.hint else 'doubtful'}: {each}")


def _bus(config: Config, name: str, seconds: float) -> list[Finding]:
    """Listen to a bus and print what comes; gives what is hard to believe of it."""
    settings = config.bus[name].settings()
    messages, errors = listen(settings | ({"fd": True} if settings["interface"] == "socketcan" else {}), seconds)
    report = bus_report(config, name, messages, seconds)
    typer.echo(f"bus {name}: {len(messages)} messages in {seconds:g} s")
    for line in (*report.lines, *survey_lines(report.others)):
        typer.echo(f"  {line}")
    if errors:
        kinds = ", ".join(f"{count} {kind}" for kind, count in errors.items())
        reason = f"error frames: {kinds}: check bit rate, wiring and termination"
        report.findings.append(Finding(f"bus.{name}", "", reason))
    return report.findings


def prepared(config: Path, report: Callable[[str], object] = lambda _: None) -> Service:
    """The service of a configuration file, all of it made and nothing started; `report` gets a line a sensor."""
    settings = load(config)
    return Service(settings, state=StateFile.of(config, settings.server.state), path=config, report=report)


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
