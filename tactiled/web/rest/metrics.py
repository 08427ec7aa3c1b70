"""`GET /metrics`: every sensor's health and counts in Prometheus's text format, version 0.0.4."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import get_args

from fastapi import APIRouter, Request, Response

from tactiled.bus.error_frames import KINDS
from tactiled.runtime.sensor import State
from tactiled.runtime.service import Service
from tactiled.web.http.connection_limit import Places
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.rest.dependencies import CurrentService

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
GAUGES = (  # name, help text, field of a sensor's status
    ("age_seconds", "time since the last frame", "age_s"),
    ("rate_hertz", "frames per second", "rate_hz"),
    ("jitter_seconds", "standard deviation of the last 100 frame periods", "jitter_s"),
    ("skew_seconds", "time from first to last message of the newest frame", "skew_s"),
)
Sample = tuple[dict[str, str], float | None]  # labels; None where there is no value now

router = APIRouter(include_in_schema=False)


@router.get("/metrics")
def metrics(request: Request, service: CurrentService) -> Response:
    """Health and counts, for Prometheus to scrape."""
    state = request.app.state
    return Response(text(service, state.streams, state.places), media_type=MEDIA_TYPE)


def text(service: Service, streams: ConcurrencyLimit, places: Places) -> str:
    """Every family of a service, its streams and its connections."""
    families = (*_sensors(service), *_clients(streams, places))
    return "".join(f"{line}\n" for family in families for line in family)


def _sensors(service: Service) -> Iterator[Iterator[str]]:
    statuses = {name: sensor.status() for name, sensor in service.sensors.items()}
    states: list[Sample] = [
        ({"sensor": name, "state": state}, float(state == status.state))
        for name, status in statuses.items()
        for state in get_args(State)
    ]
    yield _family("state", "gauge", "1 for the present state of the sensor, else 0", states)
    for gauge, help_text, field in GAUGES:
        values = [({"sensor": name}, getattr(status, field)) for name, status in statuses.items()]
        yield _family(gauge, "gauge", help_text, values)
    losses = [
        ({"sensor": name, "kind": kind}, count)
        for name, status in statuses.items()
        for kind, count in asdict(status.loss).items()
    ]
    yield _family("loss_total", "counter", "losses on the way in, by kind", losses)
    buses = {service.sensors[name].plan.bus: status.errors for name, status in statuses.items()}
    errors = [({"bus": bus, "kind": kind}, counts.get(kind, 0)) for bus, counts in buses.items() for kind in KINDS]
    yield _family("error_frames_total", "counter", "error frames of the bus, by kind", errors)


def _clients(streams: ConcurrencyLimit, places: Places) -> Iterator[Iterator[str]]:
    refused = [({"bound": bound}, count) for bound, count in streams.refused.items()]
    dropped = [({"how": how}, count) for how, count in places.dropped.items()]
    yield _family("streams", "gauge", "open WebSockets", [({}, streams.open)])
    yield _family("streams_refused_total", "counter", "refused WebSockets, by the bound that was reached", refused)
    yield _family("connections", "gauge", "open connections, with WebSockets", [({}, places.open)])
    yield _family("connections_dropped_total", "counter", "connections above the bound, by what was done", dropped)


def _family(name: str, kind: str, help_text: str, samples: Iterable[Sample]) -> Iterator[str]:
    yield f"# HELP tactiled_{name} {help_text}"
    yield f"# TYPE tactiled_{name} {kind}"
    for labels, value in samples:
        if value is not None:
            pairs = ",".join(f'{label}="{_escaped(each)}"' for label, each in labels.items())
            yield f"tactiled_{name}{f'{{{pairs}}}' if pairs else ''} {value!r}"


def _escaped(value: str) -> str:
    return value.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
