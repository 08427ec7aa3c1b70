"""`tactiled bench`: speed, accuracy and failures of restoration on this machine and on one's own skin."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.errors import ConfigError
from tactiled.study.results import machine

if TYPE_CHECKING:
    from tactiled.study.skin import Skin

# Every verb imports its own part of `study`: matplotlib and scikit-image take a second.
Config = Annotated[Path | None, typer.Option(help="Configuration whose array and cover to measure.")]
Sensor = Annotated[str | None, typer.Option(help="Its sensor; the first if left out.")]
Out = Annotated[Path, typer.Option(help="Folder for charts and tables.")]
Quick = Annotated[bool, typer.Option("--quick", help="Fewer covers, faults, scenes and frames.")]
Seed = Annotated[int, typer.Option(help="Random seed.", min=0)]
OUT = Path("bench")


def frontier(
    config: Config = None, sensor: Sensor = None, out: Out = OUT, quick: Quick = False, seed: Seed = 1
) -> None:
    """Chart error against time for every method of ours and for others', in one run on one thread."""
    from tactiled.study import frontier as study

    effort = study.QUICK_EFFORT if quick else study.Effort()
    with _measuring(out):
        skins = _skins(config, sensor, effort.covers, effort.size)
        count = len(skins) * len(effort.noises)
        panels = list(track(study.measure(skins, effort, seed), "Frontier", count, transient=True))
    study.write(out, panels, seed)
    print_table("NRMSE, and median time of a frame", study.HEADINGS, study.lines(panels))
    print_lines(*study.verdict(panels), f"Seed {seed}. One thread. {machine()}")
    print_lines(f"Written: {out}/frontier.svg, frontier.csv, frontier.json")


def stability(
    config: Config = None, sensor: Sensor = None, out: Out = OUT, quick: Quick = False, seed: Seed = 1
) -> None:
    """Let one thing after another go wrong, and show where each method becomes worse than the raw image."""
    from tactiled.study import stability as study
    from tactiled.study.faults import sweeps

    with _measuring(out):
        skins = _skins(config, sensor)
        setting, values = study.setting(quick, seed, *skins)
        steps = study.measure(setting, values)
        results = list(track(steps, "Stability", len(sweeps(setting)), transient=True))
    study.write(out, results, seed)
    title = f"Methods whose mean error is over {study.WORSE:g} times the raw image's"
    print_table(title, study.HEADINGS, study.lines(results))
    print_lines(*study.verdict(results), f"Seed {seed}. One thread. {machine()}")
    print_lines(f"Written: {out}/stability.svg, calibration.svg, stability.csv, stability.json")


def picard(
    config: Config = None,
    sensor: Sensor = None,
    noise: Annotated[float, typer.Option(help="Of a taxel, % of the frame's peak.", min=1e-6, max=100)] = 1.0,
    out: Out = OUT,
    seed: Seed = 1,
) -> None:
    """Draw the singular values of an array under its cover, and which of a scene's modes rise above the noise."""
    from tactiled.study import picard as study

    with _measuring(out):
        skins = _skins(config, sensor, (0.5, 1.0, 2.0, 3.0))
        modes = [study.measure(skin, noise / 100, seed) for skin in skins]
    study.write(out, modes)
    print_lines(*(study.line(one, noise / 100) for one in modes), f"Seed {seed}. Written: {out}/picard.svg")


def report(
    config: Config = None, sensor: Sensor = None, out: Out = OUT, quick: Quick = False, seed: Seed = 1
) -> None:
    """Measure speed, accuracy, limits and failures, and write one page that holds all charts and tables."""
    from tactiled.study import report as study

    with _measuring(out), Progress(transient=True) as progress:
        plan = study.plan(tuple(_skins(config, sensor)), quick, seed)
        task = progress.add_task("", total=plan.steps)
        results = study.measure(plan, lambda done: progress.update(task, advance=1, description=done))
    print(study.write(out, results, seed))


def latency(
    seconds: Annotated[float, typer.Option(help="How long to measure.", min=1)] = 20.0,
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=1, max=1000)] = 100.0,
    clients: Annotated[int, typer.Option(help="WebSocket clients.", min=1, max=500)] = 1,
) -> None:
    """Time a 32 x 32 array from its last CAN message to WebSocket clients on loopback."""
    from tactiled.cli.demo import demo_config, simulated
    from tactiled.runtime.service import Service
    from tactiled.study.latency import HEADINGS, lines, measure

    config = demo_config()
    with threadpool_limits(1):
        service = Service(config)
        (sensor,) = service.sensors.values()
        source = simulated(config, sensor, "tour").messages
        result = measure(service, config, source, rate_hz, seconds, clients)
    print_table(f"32 x 32 at {rate_hz:g} Hz, WebSocket clients: {clients}", HEADINGS, lines(result, clients))
    print_lines(machine())


@contextmanager
def _measuring(folder: Path) -> Iterator[None]:
    """Make the folder for the results first, and measure on one thread."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"folder {folder} cannot be made: {error.strerror}") from error
    with threadpool_limits(1):
        yield


def _skins(config: Path | None, sensor: str | None, covers: Iterable[float] = (), size: int = 32) -> "list[Skin]":
    """The configured skin, or rubber covers (t/pitch) over size x size taxels."""
    from tactiled.study.skin import configured, rubber

    return [configured(config, sensor)] if config else [rubber(thickness, size) for thickness in covers]


def print_lines(*lines: str) -> None:
    """Print each line unwrapped."""
    console = Console(soft_wrap=True, highlight=False)
    for line in lines:
        console.print(line, markup=False)


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table as wide as the terminal."""
    table = Table(*headings, title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
