"""`GET /metrics`: health, counts and times of every sensor in Prometheus's text format, version 0.0.4."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from itertools import accumulate, chain
from types import SimpleNamespace
from typing import Any, cast, get_args

from fastapi import APIRouter, Request, Response
from prometheus_client import ProcessCollector, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily as Counter
from prometheus_client.metrics_core import GaugeMetricFamily as Gauge
from prometheus_client.metrics_core import Metric

from tactiled.bus.socketcan import KINDS
from tactiled.live.sensor import Sensor
from tactiled.live.status import State
from tactiled.live.timings import BOUNDS_S, Histogram
from tactiled.web.http.connection_limit import Places
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.rest.dependencies import CurrentService
from tactiled.web.views import SensorView, ServiceView

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
GAUGES = (  # name, help text, field of a sensor's status
    ("age_seconds", "time since the last frame", "age_s"),
    ("rate_hertz", "frames per second", "rate_hz"),
    ("jitter_seconds", "standard deviation of the last 100 frame periods", "jitter_s"),
    ("skew_seconds", "time from first to last message of the newest frame", "skew_s"),
)
HISTOGRAMS = (  # name, help text, second label, field of a sensor's timings
    ("stage_seconds", "time of a frame in each stage", "stage", "stages"),
    ("restore_seconds", "time of restoring a frame, by the method that ran", "method", "methods"),
    ("frame_age_seconds", "age of a frame since its last message when it is published, and sent", "at", "ages"),
)
ESCAPES = str.maketrans({"\\": r"\\", "\n": r"\n", '"': r"\""})  # of a label's value
LE = (*map(str, BOUNDS_S), "+Inf")

router = APIRouter(include_in_schema=False)


@router.get("/metrics")
def metrics(request: Request, service: CurrentService) -> Response:
    """Health, counts and times, for Prometheus to scrape."""
    state = request.app.state
    return Response(text(service, state.streams, state.places), media_type=MEDIA_TYPE)


def text(service: ServiceView, streams: ConcurrencyLimit, places: Places) -> bytes:
    """Every family of a service, its streams, its connections and its process."""
    sensors, process = service.sensors, ProcessCollector(registry=None).collect()
    times = "".join(_times(sensors)).encode()
    return _text(_health(sensors)) + times + _text(chain(_clients(streams, places), process))


def _text(families: Iterable[Metric]) -> bytes:
    """Families as prometheus_client writes them."""
    return generate_latest(cast(Any, SimpleNamespace(collect=lambda: families)))


def _health(sensors: Mapping[str, SensorView]) -> Iterator[Metric]:
    statuses = {name: sensor.status() for name, sensor in sensors.items()}
    states = [
        (name, state, float(state == status.state))
        for name, status in statuses.items()
        for state in get_args(State)
    ]
    yield _family(Gauge, "state", "1 for the present state of the sensor, else 0", "sensor state", states)
    for gauge, help_text, field in GAUGES:
        values = [(name, getattr(status, field)) for name, status in statuses.items()]
        yield _family(Gauge, gauge, help_text, "sensor", values)
    losses = [(name, *loss) for name, status in statuses.items() for loss in asdict(status.loss).items()]
    yield _family(Counter, "loss", "losses on the way in, by kind", "sensor kind", losses)
    buses = {sensors[name].plan.bus: status.errors for name, status in statuses.items()}
    errors = [(bus, kind, counts.get(kind, 0)) for bus, counts in buses.items() for kind in KINDS]
    yield _family(Counter, "error_frames", "error frames of the bus, by kind", "bus kind", errors)
    images = [image for sensor in sensors.values() if (image := sensor.hub.latest())]
    warnings = [(image.sensor, code, 1.0) for image in images for code in {each.code for each in image.warnings}]
    yield from _regions(sensors)
    yield _family(Gauge, "warning", "1 for each warning of the newest image", "sensor code", warnings)


def _regions(sensors: Mapping[str, SensorView]) -> Iterator[Metric]:
    summaries = [
        (sensor.name, name, summary)
        for sensor in sensors.values()
        if isinstance(sensor, Sensor) and sensor.state == "live"
        for name, each in sensor.regions.series.items()
        if (summary := each.summary())
    ]
    quantities = (
        ("force", "force in a region, in the sensor's unit of force"),
        ("peak", "highest pressure in a region, in the sensor's unit"),
        ("area", "area in contact in a region, mm2"),
    )
    for key, help_text in quantities:
        values = [(sensor, name, getattr(each.now, key)) for sensor, name, each in summaries]
        yield _family(Gauge, f"region_{key}", help_text, "sensor region", values)
    exceeded = [(sensor, name, float(each.exceeded)) for sensor, name, each in summaries]
    yield _family(Gauge, "region_exceeded", "1 while a region is over its threshold", "sensor region", exceeded)


def _times(sensors: Mapping[str, SensorView]) -> Iterator[str]:
    """The histograms, most of the text: prometheus_client, which checks every name in every line, is slow."""
    for name, help_text, label, field in HISTOGRAMS:
        family = f"tactiled_{name}"
        yield f"# HELP {family} {help_text}\n# TYPE {family} histogram\n"
        for sensor in sensors.values():
            histograms: dict[str, Histogram] = getattr(sensor.timings, field)
            for value, histogram in histograms.copy().items():
                labels = f'sensor="{sensor.name.translate(ESCAPES)}",{label}="{value}"'
                counts = [*accumulate(histogram.counts.copy())]
                for le, count in zip(LE, counts, strict=True):
                    yield f'{family}_bucket{{{labels},le="{le}"}} {count}\n'
                yield f"{family}_count{{{labels}}} {counts[-1]}\n{family}_sum{{{labels}}} {histogram.sum_s}\n"


def _clients(streams: ConcurrencyLimit, places: Places) -> Iterator[Metric]:
    refused, dropped = streams.refused.items(), places.dropped.items()
    yield Gauge("tactiled_streams", "open WebSockets", streams.open)
    yield _family(Counter, "streams_refused", "refused WebSockets, by the bound reached", "bound", refused)
    yield Gauge("tactiled_connections", "open connections, with WebSockets", places.open)
    yield _family(Counter, "connections_dropped", "connections above the bound, by what was done", "how", dropped)


def _family(kind: type[Gauge | Counter], name: str, text: str, labels: str, samples: Iterable[Any]) -> Metric:
    """A family of (label values, ..., value), those without a value left out."""
    family = kind(f"tactiled_{name}", text, labels=labels.split())
    for *label_values, value in samples:
        if value is not None:
            family.add_metric(label_values, value)
    return family
