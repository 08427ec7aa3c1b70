"""`tactiled bench`: speed, accuracy and failures of restoration, here and on one's own skin; `tactiled paper`."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tactiled.bench.results import host_meter, machine, make_folder
from tactiled.errors import ConfigError

if TYPE_CHECKING:
    from tactiled.bench.skin import Skin

# Every verb imports its own part of `bench`: matplotlib and scikit-image take a second.
Config = Annotated[Path | None, typer.Option(help="Configuration whose array and cover to measure.")]
Sensor = Annotated[str | None, typer.Option(help="Its sensor; the first if left out.")]
Out = Annotated[Path, typer.Option(help="Folder for charts and tables.")]
Reduced = Annotated[bool, typer.Option("--quick", help="Fewer covers, faults, scenes and frames.")]
Seed = Annotated[int, typer.Option(help="Random seed.", min=0)]
OUT = Path("bench")


@contextmanager
def _measuring(folder: Path, config: Path | None, sensor: str | None) -> "Iterator[list[Skin]]":
    """Make the folder for the results; on one thread, give the configured skin, or none."""
    from tactiled.bench.skin import configured

    make_folder(folder)
    with threadpool_limits(1):
        yield [configured(config, sensor)] if config else []


def frontier(
    config: Config = None, sensor: Sensor = None, out: Out = OUT, reduced: Reduced = False, seed: Seed = 1
) -> None:
    """Chart error against time for every method of ours and for others', in one run on one thread."""
    from tactiled.bench import frontier as bench

    with _measuring(out, config, sensor) as skins:
        panels = bench.measure(skins, reduced, seed)
    bench.write(out, panels, seed)
    print_table("NRMSE, and median time of a frame", bench.HEADINGS, bench.lines(panels))
    print(*bench.verdict(panels), f"Seed {seed}. One thread. {machine()}", sep="\n")
    print(f"Written: {out}/frontier.svg, frontier.csv, frontier.json")


def stability(
    config: Config = None, sensor: Sensor = None, out: Out = OUT, reduced: Reduced = False, seed: Seed = 1
) -> None:
    """Let one thing after another go wrong, and show where each method becomes worse than the raw image."""
    from tactiled.bench import stability as bench

    with _measuring(out, config, sensor) as skins:
        results = bench.measure(bench.setting(reduced, seed, *skins))
    bench.write(out, results, seed)
    title = f"Methods whose mean error is over {bench.WORSE:g} times the raw image's"
    print_table(title, bench.HEADINGS, bench.lines(results))
    print(*bench.verdict(results), f"Seed {seed}. One thread. {machine()}", sep="\n")
    print(f"Written: {out}/stability.svg, calibration.svg, stability.csv, stability.json")


def picard(
    config: Config = None,
    sensor: Sensor = None,
    noise: Annotated[float, typer.Option(help="Of a taxel, % of the frame's peak.", min=1e-6, max=100)] = 1.0,
    out: Out = OUT,
    seed: Seed = 1,
) -> None:
    """Draw the singular values of an array under its cover, and which of a scene's modes rise above the noise."""
    from tactiled.bench import picard as bench

    with _measuring(out, config, sensor) as skins:
        modes = bench.measure(skins, noise / 100, seed)
    bench.write(out, modes)
    for one in modes:
        print(
            f"{one.skin}: {one.clear} of {one.singular.size} modes of the scene {one.scene!r} rise above a noise"
            f" of {noise:g} % of the peak; the finest has a half-period of {one.resolution_mm:.2f} mm"
        )
    print(f"Seed {seed}. Written: {out}/picard.svg")


def calibration(
    trials: Annotated[int, typer.Option(help="Simulated skins to calibrate.", min=1, max=10_000)] = 20,
    way: Annotated[Literal["tip", "edge", "blind"] | None, typer.Option(help="Only this way.")] = None,
    out: Out = OUT,
    seed: Seed = 1,
) -> None:
    """Calibrate simulated skins whose gains and covers are known, and hold the results against the truth."""
    from tactiled.bench import calibration as bench

    make_folder(out)
    with threadpool_limits(1):
        results = bench.measure(trials, seed, way)
    bench.write(out, results)
    print_table(f"Calibration of {trials} simulated skins", bench.HEADINGS, bench.lines(results))
    print(f"Seed {seed}. One thread. {machine()}")
    print(f"Written: {out}/calibration_trials.svg, calibration_trials.csv")


def report(
    config: Config = None, sensor: Sensor = None, out: Out = OUT, reduced: Reduced = False, seed: Seed = 1
) -> None:
    """Measure speed, accuracy, limits and failures, and write one page that holds all charts and tables."""
    from tactiled.bench.report import write

    with _measuring(out, config, sensor) as skins:
        print(write(out, skins, reduced, seed))


def paper(out_dir: Annotated[Path, typer.Argument(help="Folder for the figures and index.html.")]) -> None:
    """Reproduce the figures of Shimojo's paper, and compare its statements with both models."""
    from tactiled.bench.paper.page import write

    with threadpool_limits(1):
        print(write(out_dir))


def load(
    sensors: Annotated[list[int], typer.Option(help="Arrays of 32 x 32; several values: one run each.")] = [1, 8],  # noqa: B006
    clients: Annotated[list[int], typer.Option(help="WebSocket clients, of one array each; the same.")] = [1, 20],  # noqa: B006
    rate_hz: Annotated[list[float], typer.Option(help="Frames a second of each array; the same.")] = [100.0],  # noqa: B006
    pull: Annotated[bool, typer.Option("--pull", help="Clients ask for every image, as viewers do.")] = False,
    seconds: Annotated[float, typer.Option(help="How long each run is measured.", min=1)] = 10.0,
) -> None:
    """Load a service with arrays and clients: processor time, age of images at the clients, and what is lost."""
    from tactiled.bench import load as bench

    rows, host = [], host_meter()
    with threadpool_limits(1):
        for each, count, hz in product(sensors, clients, rate_hz):
            if not (1 <= each <= 64 and 1 <= count <= 500 and 1 <= hz <= 1000):
                raise ConfigError(f"{each} sensors, {count} clients, {hz:g} Hz: give 1 to 64, 1 to 500, 1 to 1000")
            result = bench.measure(each, count, hz, seconds, pull)
            rows.append(bench.line(each, hz, pull, result))
    title = "32 x 32 over CAN FD; cores of service + clients, age from the last message"
    print_table(title, bench.HEADINGS, rows)
    print(f"{machine()}{host()}")


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table as wide as the terminal."""
    table = Table(*headings, title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
