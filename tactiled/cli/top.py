"""`tactiled top`: a table of a running service, kept up to date."""

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Annotated

import typer
from prometheus_client.parser import text_string_to_metric_families
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table

from tactiled import logs
from tactiled.cli.app import stoppable
from tactiled.client import Client
from tactiled.errors import TactileError

PLAIN_WIDTH = 250  # columns of a table that is no terminal's: no row is broken
COLUMNS = ("sensor", "state", "Hz", "published ms", "sent ms", "restored ms", "losses", "warnings")
NONE, AGES = "–", "tactiled_frame_age_seconds"
Labels = Mapping[str, str]


class Scrape:
    """The metrics of a service at one moment."""

    def __init__(self, client: Client) -> None:
        """TactileError where no service of tactiled answers."""
        text, self.time = client.metrics(), time.monotonic()
        self._samples: dict[str, list[tuple[Labels, float]]] = {}
        try:
            families = [*text_string_to_metric_families(text)]
            for each in (sample for family in families for sample in family.samples):
                labels = {name: logs.printable(value) for name, value in each.labels.items()}
                self._samples.setdefault(each.name, []).append((labels, each.value))
        except ValueError as error:
            raise TactileError(f"{client.url}: no service of tactiled: its metrics cannot be read") from error
        if not any(family.name == "tactiled_state" for family in families):  # a server may have no sensor yet
            raise TactileError(f"{client.url}: no service of tactiled: it has no metrics of sensors")

    def of(self, name: str, **labels: str) -> list[tuple[Labels, float]]:
        """The samples of this name that have these labels."""
        pairs = labels.items()
        return [each for each in self._samples.get(name, ()) if pairs <= each[0].items()]

    def value(self, name: str, **labels: str) -> float:
        """The one sample of this name and these labels; NaN where there is none."""
        return next((value for _, value in self.of(name, **labels)), math.nan)


class Interval:
    """What happened from one scrape to the next."""

    def __init__(self, before: Scrape, after: Scrape) -> None:
        self.before, self.after, self.seconds = before, after, after.time - before.time

    def increase(self, name: str, **labels: str) -> float:
        """Of a counter; one that has fallen began anew."""
        now, then = self.after.value(name, **labels), self.before.value(name, **labels)
        return now - then if now >= then else now

    def quantile(self, share: float, name: str, **labels: str) -> float:
        """Of a histogram, interpolated in its bucket as Prometheus does; NaN where nothing was counted."""
        bounds = [each["le"] for each, _ in self.after.of(f"{name}_bucket", **labels)]
        counts = [self.increase(f"{name}_bucket", **labels, le=each) for each in bounds]
        if not counts or not counts[-1] > 0:
            return math.nan
        rank, below, lower = share * counts[-1], 0.0, 0.0
        for upper, count in zip(map(float, bounds), counts, strict=True):
            if count >= rank:
                return lower if upper == math.inf else lower + (upper - lower) * (rank - below) / (count - below)
            below, lower = count, upper
        return math.nan

    def cells(self, sensor: str) -> Iterator[str]:
        """The row of a sensor, by COLUMNS."""
        after = self.after
        yield sensor
        yield next((each["state"] for each, value in after.of("tactiled_state", sensor=sensor) if value), NONE)
        yield f"{after.value('tactiled_rate_hertz', sensor=sensor):.1f}"
        for at in ("publish", "send"):
            median, high = (self.quantile(share, AGES, sensor=sensor, at=at) for share in (0.5, 0.99))
            yield NONE if math.isnan(median) else f"{1e3 * median:.2f} / {1e3 * high:.2f}"
        yield self._methods(sensor)
        losses = after.of("tactiled_loss_total", sensor=sensor)
        yield ", ".join(self._loss(labels, count) for labels, count in losses if count) or NONE
        yield ", ".join(sorted(each["code"] for each, _ in after.of("tactiled_warning", sensor=sensor))) or NONE

    def _loss(self, labels: Labels, count: float) -> str:
        more = self.increase("tactiled_loss_total", **labels)
        return f"{labels['kind']} {count:.0f}" + (f" (+{more:.0f})" if more else "")

    def _methods(self, sensor: str) -> str:
        """Mean time of each method that ran."""
        name, means = "tactiled_restore_seconds", []
        for labels, _ in self.after.of(f"{name}_count", sensor=sensor):
            if count := self.increase(f"{name}_count", **labels):
                means.append(f"{labels['method']} {1e3 * self.increase(f'{name}_sum', **labels) / count:.2f}")
        return ", ".join(means) or NONE

    def caption(self) -> str:
        """The process and its clients."""
        cores = self.increase("process_cpu_seconds_total") / self.seconds
        memory_mb = self.after.value("process_resident_memory_bytes") / 1e6
        streams, connections = (self.after.value(f"tactiled_{name}") for name in ("streams", "connections"))
        process = "" if math.isnan(cores) else f"{cores:.2f} cores, {memory_mb:.0f} MB, "
        return f"{process}{streams:.0f} streams, {connections:.0f} connections"


def table(url: str, interval: Interval, plain: bool) -> Table:
    """What `top` shows."""
    lines = Table(*COLUMNS, title=url, caption=interval.caption(), box=None if plain else SIMPLE_HEAD)
    lines.title_justify = lines.caption_justify = "left"
    for sensor in dict.fromkeys(each["sensor"] for each, _ in interval.after.of("tactiled_state")):
        lines.add_row(*interval.cells(sensor))
    return lines


def top(
    url: Annotated[str, typer.Argument(help="Address of the service.")] = "http://127.0.0.1:8000",
    token: Annotated[str | None, typer.Option(envvar="TACTILED_TOKEN", help="Token, if it needs one.")] = None,
    seconds: Annotated[float, typer.Option("--interval", help="Seconds that a table covers.", min=0.1)] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Print one table and exit.")] = False,
) -> None:
    """Show rates, ages, losses, warnings and processor time of a running service.

    Ages are the median and the 99th percentile since a frame's last message, `restored ms` is the mean of each
    method. Without a terminal, a plain table is printed every interval. While the service is away, it says why.
    """
    console = Console(markup=False, highlight=False)
    if plain := not console.is_terminal:
        console = Console(markup=False, highlight=False, width=PLAIN_WIDTH)
    client, show = Client(url, token), console.print
    before = Scrape(client)
    with stoppable(), ExitStack() as stack:
        if not plain and not once:
            live = stack.enter_context(Live(console=console, screen=True, auto_refresh=False))
            show = partial(live.update, refresh=True)
        while True:
            time.sleep(seconds)
            try:
                after = Scrape(client)
            except TactileError as error:
                if once:
                    raise
                show(logs.printable(str(error)))
                continue
            show(table(client.url, Interval(before, after), plain))
            before = after
            if once:
                return
